import json
import shlex
from pathlib import Path

import pytest

from lerobot_gloves.demo import PACKAGED, TRIO, pipeline
from lerobot_gloves.demo.export import describe
from lerobot_gloves.demo.training import Training, train_trio
from tests.builders import save_policy

EVERYTHING = ["recording", "copilot", "expert flow", "agent", "calibration of expert flow", "calibration of copilot"]


class KilledError(Exception):
    """What a test ends a stage with."""


@pytest.fixture
def play(tmp_path, monkeypatch):
    """Plays `train_trio` with commands that only leave the files that theirs would; returns those that ran."""
    monkeypatch.setattr(pipeline, "console_script", lambda name: name)
    what = Training(tmp_path / "out", demonstrations=48, steps=20)

    def leave(command):
        if command.label == "recording":
            (what.dataset.root / "meta").mkdir(parents=True)
            (what.dataset.root / "meta" / "info.json").write_text("{}")
        elif command.label.startswith("calibration"):
            name = command.label.removeprefix("calibration of ").replace(" ", "_")
            (what.root / name / "calibration.safetensors").write_bytes(b"scores")
        else:
            name = command.label.replace(" ", "_")
            checkpoint(what, name, step=20)

    def play(what=what, *, killed_in=None):
        ran = []

        def run(commands, *, began):
            ran.extend(commands)
            for command in commands:
                if command.label == killed_in:
                    raise KilledError
                leave(command)

        monkeypatch.setattr(pipeline, "run", run)
        try:
            train_trio(what, began=0.0)
        except KilledError:
            assert killed_in
        return ran

    play.what = what
    return play


def checkpoint(what: Training, name: str, step: int) -> Path:
    """A checkpoint of a training run of 20 steps."""
    kind = {"agent": "gloves_flow_policy"}.get(name, f"gloves_{name}")
    checkpoints = what.train(name).folder / "checkpoints"
    folder = save_policy(checkpoints / f"{step:06d}" / "pretrained_model", kind)
    (folder / "train_config.json").write_text(json.dumps({"steps": 20, "output_dir": "here"}))
    state = folder.parent / "training_state" / "training_step.json"
    state.parent.mkdir(exist_ok=True)
    state.write_text(json.dumps({"step": step}))
    (checkpoints / "last").unlink(missing_ok=True)
    (checkpoints / "last").symlink_to(f"{step:06d}")
    return folder


def labels(commands):
    return [command.label for command in commands]


def test_all_stages_in_order_and_none_of_them_twice(play):
    assert labels(play()) == EVERYTHING
    assert labels(play()) == []
    root = play.what.root
    assert {*TRIO, "README.md"} <= {file.name for file in root.iterdir()}
    readme = (root / "README.md").read_text()
    assert all(f"{name}/calibration.safetensors" in readme for name in ("expert_flow", "copilot"))


@pytest.mark.parametrize("stage", range(len(EVERYTHING)))
def test_it_goes_on_in_the_stage_in_which_it_was_killed(play, stage):
    before = labels(play(killed_in=EVERYTHING[stage]))
    assert before[-1] == EVERYTHING[stage] or stage in (1, 2, 3, 4)  # trainings, and calibrations, are started together
    assert labels(play()) == EVERYTHING[stage:]
    assert labels(play()) == []


def test_training_goes_on_from_its_last_checkpoint(play):
    play(killed_in="copilot")
    checkpoint(play.what, "copilot", step=10)
    commands = {command.label: command.words for command in play()}
    assert "--resume=true" in commands["copilot"]
    assert f"--config_path={play.what.train('copilot').checkpoint / 'train_config.json'}" in commands["copilot"]
    assert "--resume=true" not in commands["expert flow"]
    assert f"--config_path={PACKAGED / 'expert_flow.yaml'}" in commands["expert flow"]


def test_a_half_written_checkpoint_does_not_count(play):
    play(killed_in="agent")
    checkpoint(play.what, "agent", step=10)
    (play.what.train("agent").folder / "checkpoints" / "000020" / "pretrained_model").mkdir(parents=True)
    assert play.what.train("agent").taken == 10
    assert "--resume=true" in {command.label: command.words for command in play()}["agent"]


def test_a_run_without_checkpoint_begins_anew(play):
    play(killed_in="agent")
    (play.what.train("agent").folder / "half").mkdir(parents=True)
    play(killed_in="agent")
    assert not (play.what.train("agent").folder / "half").exists()  # lerobot-train refuses an existing folder


def test_a_recording_that_was_not_cleaned_up_is_finished_first(play):
    play()
    (play.what.root / "dataset.staging").mkdir()
    assert not play.what.record.done


def test_another_trio_is_not_mistaken_for_this_one(play):
    play(killed_in="agent")
    with pytest.raises(
        ValueError, match=r"out holds a trio that was made with another setting of steps: choose another"
    ):
        play(Training(play.what.root, demonstrations=48, steps=30))


def test_the_recipe_names_no_place_of_this_machine(tmp_path):
    commands = [shlex.split(command) for command in Training(tmp_path).recipe()]
    assert [command[0] for command in commands] == [
        "gloves",
        *["lerobot-train"] * 3,
        *["python"] * 3,
        "gloves",
        "gloves",
    ]
    assert not any(str(tmp_path) in word or str(PACKAGED) in word for command in commands for word in command)
    assert "--config_path=lerobot_gloves/demo/agent.yaml" in commands[1]
    assert commands[4][3:] == ["outputs/demo/training/agent/checkpoints/last/pretrained_model", "outputs/demo/agent"]
    assert (
        '--scores=["reverse:steps=1", "reverse:steps=5"]' in commands[7]
        and commands[7][2] == "--policy.path=outputs/demo/expert_flow"
    )
    assert "--policy.path=outputs/demo/copilot" in commands[8]


def test_the_recipe_of_the_packaged_trio_is_this_one(tmp_path):
    assert describe(PACKAGED, TRIO, Training(tmp_path).recipe()) == (PACKAGED / "README.md").read_text()
