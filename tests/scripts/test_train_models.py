"""What train_models.py would run, from the configurations that ship; the commands have tests of their own."""

import json
from pathlib import Path

import pytest

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
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
    """The labels of the commands in order; each leaves behind what it would make."""
    for folder in ("configs", "lerobot_gloves"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    labels = []

    def run(jobs, *, began):
        for job in jobs:
            labels.append(job.label)
            options = dict(option.removeprefix("--").split("=", 1) for option in job.command if option.startswith("--"))
            if folder := options.get("output_dir"):
                write_checkpoint(Path(folder), int(options["steps"]))
            elif "policy.path" in options:
                (Path(options["policy.path"]) / CALIBRATION_NAME).touch()
            else:
                info = Path(options.get("new_root") or options["dataset.root"]) / "meta" / "info.json"
                info.parent.mkdir(parents=True)
                info.write_text(json.dumps({}))

    monkeypatch.setattr(train_models, "run", run)
    return labels


def test_every_model_is_made_after_what_it_needs_and_only_once(made):
    everything = list(train_models.MODELS)
    Models("keypad", None, 1).make(everything)
    sources = [f"recording agent_{source}" for source in ("none", "noised", "laggy", "slow", "shift")]
    assert made == [
        "recording state",
        *("agent", "expert_flow", "ddpm_assist", "csa_teacher"),
        *("calibration of expert_flow", "csa_student"),
        *sources,
        *("merging", "align_flow", "calibration of align_flow"),
    ]
    Models("keypad", None, 1).make(everything)
    assert len(made) == 15
    (Path("outputs/keypad/expert_flow/checkpoints/last/pretrained_model") / CALIBRATION_NAME).unlink()
    Models("keypad", None, 1).make(everything)
    assert made[15:] == ["calibration of expert_flow"]


def test_charger_has_fewer_proposals_to_each_of_the_experts(made):
    for task, options in (("keypad", set()), ("charger", {"--dataset.num_episodes=100"})):
        [job] = Models(task, None, 1).record_proposals("slow", "slow:alpha=0.5,p=1.0")
        assert "--perturbation=slow:alpha=0.5,p=1.0" in job.command
        assert {one for one in job.command if one.startswith("--dataset.num_episodes")} == options


def test_slaloms_pair_ships(made):
    Models("slalom", 20, 1).make(list(train_models.MODELS))
    assert {"agent", "expert_flow", "calibration of expert_flow"}.isdisjoint(made)
    assert made[1:4] == ["ddpm_assist", "csa_teacher", "csa_student"]


def test_an_ablation_is_trained_in_its_own_environment_by_its_tasks_configurations(made):
    models = Models("charger_hidden", None, 1)
    [job] = models.record("state")
    assert {"--env.type=gloves_charger", "--env.hide_receptacle=true"} < set(job.command)
    [job] = models.train("agent")
    assert "--config_path=configs/cpu/charger_agent.yaml" in job.command
    assert "--output_dir=outputs/charger_hidden/agent" in job.command
    models.make(list(train_models.MODELS))
    assert made == ["recording state", "agent", "expert_flow", "calibration of expert_flow"]


def test_a_training_goes_on_from_its_last_checkpoint(made):
    run = Path("outputs/keypad/agent")
    write_checkpoint(run, 2000)
    [job] = Models("keypad", None, 1).train("agent")
    assert "--resume=true" in job.command
    assert f"--config_path={run / 'checkpoints' / 'last' / 'pretrained_model' / 'train_config.json'}" in job.command
    assert Models("keypad", 2000, 1).train("agent") == []
