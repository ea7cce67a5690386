import json
import shlex
from pathlib import Path

import pytest

from lerobot_gloves.demo import PACKAGED, training
from lerobot_gloves.demo.training import Training, train_pair
from tests.builders import save_policy

EVERYTHING = ["recording", "agent", "expert flow", "calibration"]


class KilledError(Exception):
    """What a test ends a stage with."""


@pytest.fixture
def play(tmp_path, monkeypatch):
    """Plays `train_pair` with commands that only leave the files that theirs would; returns the jobs that ran."""
    monkeypatch.setattr(training, "console_script", lambda name: name)
    what = Training(tmp_path / "out", demonstrations=48, steps=20)

    def leave(job):
        if job.label == "recording":
            (what.dataset / "meta").mkdir(parents=True)
            (what.dataset / "meta" / "info.json").write_text("{}")
        elif job.label == "calibration":
            (what.root / "expert_flow" / "calibration.safetensors").write_bytes(b"scores")
        else:
            name = job.label.replace(" ", "_")
            checkpoint(what, name, step=20)

    def play(what=what, *, killed_in=None):
        ran = []

        def run(jobs, *, began):
            ran.extend(jobs)
            for job in jobs:
                if job.label == killed_in:
                    raise KilledError
                leave(job)

        monkeypatch.setattr(training, "run", run)
        try:
            train_pair(what, began=0.0)
        except KilledError:
            assert killed_in
        return ran

    play.what = what
    return play


def checkpoint(what: Training, name: str, step: int) -> Path:
    """A checkpoint of a training run of 20 steps."""
    kind = {"agent": "gloves_flow_policy", "expert_flow": "gloves_expert_flow"}[name]
    checkpoints = what.run_folder(name) / "checkpoints"
    folder = save_policy(checkpoints / f"{step:06d}" / "pretrained_model", kind)
    (folder / "train_config.json").write_text(json.dumps({"steps": 20, "output_dir": "here"}))
    state = folder.parent / "training_state" / "training_step.json"
    state.parent.mkdir(exist_ok=True)
    state.write_text(json.dumps({"step": step}))
    (checkpoints / "last").unlink(missing_ok=True)
    (checkpoints / "last").symlink_to(f"{step:06d}")
    return folder


def labels(jobs):
    return [job.label for job in jobs]


def test_all_stages_in_order_and_none_of_them_twice(play):
    assert labels(play()) == EVERYTHING
    assert labels(play()) == []
    root = play.what.root
    assert {"agent", "expert_flow", "README.md"} <= {file.name for file in root.iterdir()}
    assert "expert_flow/calibration.safetensors" in (root / "README.md").read_text()


@pytest.mark.parametrize("stage", range(len(EVERYTHING)))
def test_it_goes_on_in_the_stage_in_which_it_was_killed(play, stage):
    before = labels(play(killed_in=EVERYTHING[stage]))
    assert before[-1] == EVERYTHING[stage] or stage in (1, 2)  # both trainings are started together
    assert labels(play()) == EVERYTHING[stage:]
    assert labels(play()) == []


def test_training_goes_on_from_its_last_checkpoint(play):
    play(killed_in="agent")
    checkpoint(play.what, "agent", step=10)
    jobs = {job.label: job.command for job in play()}
    assert "--resume=true" in jobs["agent"]
    assert f"--config_path={play.what.checkpoint('agent') / 'train_config.json'}" in jobs["agent"]
    assert "--resume=true" not in jobs["expert flow"]
    assert f"--config_path={PACKAGED / 'expert_flow.yaml'}" in jobs["expert flow"]


def test_a_half_written_checkpoint_does_not_count(play):
    play(killed_in="agent")
    checkpoint(play.what, "agent", step=10)
    (play.what.run_folder("agent") / "checkpoints" / "000020" / "pretrained_model").mkdir(parents=True)
    assert training.steps_done(play.what.run_folder("agent")) == 10
    assert "--resume=true" in {job.label: job.command for job in play()}["agent"]


def test_a_run_without_checkpoint_begins_anew(play):
    play(killed_in="agent")
    (play.what.run_folder("agent") / "half").mkdir(parents=True)
    play(killed_in="agent")
    assert not (play.what.run_folder("agent") / "half").exists()  # lerobot-train refuses an existing folder


def test_a_recording_that_was_not_cleaned_up_is_finished_first(play):
    play()
    (play.what.root / "dataset.staging").mkdir()
    assert not training.is_recorded(play.what.dataset)


def test_another_pair_is_not_mistaken_for_this_one(play):
    play(killed_in="agent")
    with pytest.raises(
        ValueError, match=r"out holds a pair that was made with another setting of steps: choose another"
    ):
        play(Training(play.what.root, demonstrations=48, steps=30))


def test_the_recipe_names_no_place_of_this_machine(tmp_path):
    commands = [shlex.split(command) for command in Training(tmp_path).recipe()]
    assert [command[0] for command in commands] == ["gloves", *["lerobot-train"] * 2, *["python"] * 2, "gloves"]
    assert not any(str(tmp_path) in word or str(PACKAGED) in word for command in commands for word in command)
    assert "--config_path=lerobot_gloves/demo/agent.yaml" in commands[1]
    assert commands[3][3:] == ["outputs/demo/training/agent/checkpoints/last/pretrained_model", "outputs/demo/agent"]
    assert '--scores=["reverse:steps=1", "reverse:steps=5"]' in commands[5]
