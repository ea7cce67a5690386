"""What train_models.py would run, from the configurations that ship; the commands have tests of their own."""

import json
from pathlib import Path

import pytest
import yaml

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_gloves.checkpoints.card import CARD_NAME
from lerobot_gloves.demo import pipeline
from scripts import train_models
from scripts.train_models import Models

ROOT = Path(__file__).parents[2]


def write_checkpoint(run: Path, step: int) -> None:
    """What a training run leaves after so many steps, as far as it is looked at."""
    checkpoint = run / "checkpoints" / f"{step:06d}"
    (checkpoint / "pretrained_model").mkdir(parents=True)
    (checkpoint / "training_state").mkdir()
    (checkpoint / "training_state" / "training_step.json").write_text(json.dumps({"step": step}))
    (checkpoint.parent / "last").symlink_to(checkpoint.name)


@pytest.fixture
def made(monkeypatch, tmp_path):
    """The commands in order; each leaves behind what it would make."""
    for folder in ("configs", "lerobot_gloves"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    commands = []

    def run(given, *, began):
        for command in given:
            commands.append(command)
            words = command.words
            options = dict(option.removeprefix("--").split("=", 1) for option in words if option.startswith("--"))
            if folder := options.get("output_dir"):
                configured = yaml.safe_load(Path(options["config_path"]).read_text())["steps"]
                write_checkpoint(Path(folder), int(options.get("steps", configured)))
            elif "policy.path" in options:
                (Path(options["policy.path"]) / CALIBRATION_NAME).touch()
            else:
                info = Path(options.get("new_root") or options["dataset.root"]) / "meta" / "info.json"
                info.parent.mkdir(parents=True)
                info.write_text(json.dumps({}))

    monkeypatch.setattr(pipeline, "run", run)
    monkeypatch.setattr(pipeline, "renew_card", lambda folder, _: (folder / CARD_NAME).touch())
    return commands


def labels(commands) -> list[str]:
    return [command.label for command in commands]


def test_every_model_is_made_after_what_it_needs_and_only_once(made):
    everything = list(train_models.MODELS)
    Models("keypad", None, 1).make(everything)
    sources = [f"recording agent_{source}" for source in ("none", "noised", "laggy", "slow", "shift")]
    assert labels(made) == [
        "recording state",
        *("agent", "expert_flow", "copilot", "ddpm_assist", "csa_teacher"),
        *("calibration of expert_flow", "calibration of copilot", "csa_student"),
        *sources,
        *("merging", "align_flow", "calibration of align_flow"),
    ]
    Models("keypad", None, 1).make(everything)
    assert len(made) == 17
    (Path("outputs/keypad/expert_flow/checkpoints/last/pretrained_model") / CALIBRATION_NAME).unlink()
    Models("keypad", None, 1).make(everything)
    assert labels(made[17:]) == ["calibration of expert_flow"]
    for model in everything:
        assert (Models("keypad", None, 1).train(model).checkpoint / CARD_NAME).is_file(), model


def test_charger_has_fewer_proposals_to_each_of_the_experts(made):
    for task, options in (("keypad", set()), ("charger", {"--dataset.num_episodes=100"})):
        words = Models(task, None, 1).record_proposals("slow", "slow:alpha=0.5,p=1.0").words
        assert "--perturbation=slow:alpha=0.5,p=1.0" in words
        assert {one for one in words if one.startswith("--dataset.num_episodes")} == options


def test_slaloms_pair_ships(made):
    Models("slalom", 20, 1).make(list(train_models.MODELS))
    assert {"agent", "expert_flow", "calibration of expert_flow"}.isdisjoint(labels(made))
    assert labels(made[1:4]) == ["copilot", "ddpm_assist", "csa_teacher"]


def test_another_training_has_other_random_numbers_and_the_same_data_and_agent(made, monkeypatch):
    models = Models("slalom", None, 1, seed=1)
    models.make(list(train_models.MODELS))
    trained = {command.label: set(command.words) for command in made if "lerobot-train" in command.words[0]}
    assert list(trained) == ["expert_flow", "copilot", "csa_teacher", "csa_student", "align_flow"]
    for model, words in trained.items():
        data = "align" if model == "align_flow" else "state"
        folder = f"--output_dir=outputs/slalom_seed1/{model}"
        assert {"--seed=1", folder, f"--dataset.repo_id=gloves/slalom_{data}"} < words
    teacher = "outputs/slalom_seed1/csa_teacher/checkpoints/last/pretrained_model"
    assert f"--policy.teacher={teacher}" in trained["csa_student"]
    for recorded in (c for c in made if c.label.startswith("recording agent")):
        assert "--agent=lerobot_gloves/demo/agent" in recorded.words
    monkeypatch.setattr(train_models, "push", lambda folder, name: f"{folder} {name}")
    (pushed,) = models.push(["copilot"], "me")
    assert pushed.split()[1] == "me/gloves_slalom_seed1_copilot"


def test_an_ablation_is_trained_in_its_own_environment_by_its_tasks_configurations(made):
    models = Models("charger_hidden", None, 1)
    assert {"--env.type=gloves_charger", "--env.hide_receptacle=true"} < set(models.record("state").words)
    words = set(models.train("agent").words)
    assert {"--config_path=configs/cpu/agent.yaml", "--output_dir=outputs/charger_hidden/agent"} < words
    assert {"--policy.chunk_size=2", "--batch_size=64", "--steps=15000"} < words
    models.make(list(train_models.MODELS))
    assert labels(made) == ["recording state", "agent", "expert_flow", "calibration of expert_flow"]


def test_with_cameras_the_correctors_look_through_the_expert_flows_encoders(made):
    Models("can_pixels", None, 1).make(list(train_models.MODELS))
    trained = {command.label: set(command.words) for command in made if "lerobot-train" in command.words[0]}
    assert list(trained) == ["agent", "expert_flow", "copilot", "csa_teacher", "csa_student"]
    recorded = made[0].words
    assert {"--env.obs_type=pixels_agent_pos", "--env.image_size=96"} < set(recorded)
    start = "--policy.pretrained_backbone_weights="
    seen = f"{start}outputs/can_pixels/expert_flow/checkpoints/last/pretrained_model"
    for model in ("agent", "expert_flow", "csa_student"):  # a student starts from its teacher
        assert f"{start}null" in trained[model]
    for model in ("copilot", "csa_teacher"):
        assert {seen, "--policy.optimizer_lr_backbone=0.0"} < trained[model]
    for words in trained.values():
        assert {"--policy.backbone_dtype=bfloat16", "--dataset.repo_id=gloves/can_pixels_state"} < words


def test_a_training_goes_on_from_its_last_checkpoint(made):
    run = Path("outputs/keypad/agent")
    write_checkpoint(run, 2000)
    last = run / "checkpoints" / "last" / "pretrained_model" / "train_config.json"
    agent = Models("keypad", None, 1).train("agent")
    assert not agent.done
    assert {"--resume=true", f"--config_path={last}", "--steps=10000"} < set(agent.begin())
    assert Models("keypad", 2000, 1).train("agent").done


def test_every_model_is_trained_on_its_data_and_the_student_by_its_teacher(made):
    Models("keypad", None, 1).make(list(train_models.MODELS))
    trained = {command.label: command.words for command in made if "lerobot-train" in command.words[0]}
    assert list(trained) == list(train_models.MODELS)
    for model, words in trained.items():
        data = "keypad_align" if model == "align_flow" else "keypad_state"
        assert {f"--dataset.repo_id=gloves/{data}", f"--dataset.root=outputs/datasets/{data}"} < set(words)
        assert any("--policy.teacher" in word for word in words) == (model == "csa_student")
    assert "--policy.teacher=outputs/keypad/csa_teacher/checkpoints/last/pretrained_model" in trained["csa_student"]
