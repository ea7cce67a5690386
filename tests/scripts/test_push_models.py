"""What train_models.py leaves is what belongs on the Hub, and one command puts it there."""

import json
import sys
from pathlib import Path

import pytest
from huggingface_hub import ModelCard

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from lerobot_gloves.checkpoints.card import CARD_NAME
from scripts.train_models import Models, main
from tests.builders import calibrate, save_policy

ROOT = Path(__file__).parents[2]
TASK = "charger_hidden"
KINDS = {"agent": "gloves_flow_policy", "expert_flow": "gloves_expert_flow"}
"""The models of that benchmark."""


@pytest.fixture
def folders(monkeypatch, tmp_path):
    """Where the task's models lie, trained and calibrated, but without a card."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    info = Path(f"outputs/datasets/{TASK}_state/meta/info.json")
    info.parent.mkdir(parents=True)
    info.touch()
    found = {}
    for model, kind in KINDS.items():
        checkpoint = Path(f"outputs/{TASK}/{model}/checkpoints/015000")
        found[model] = save_policy(checkpoint / "pretrained_model", kind)
        (checkpoint / "training_state").mkdir()
        (checkpoint / "training_state" / "training_step.json").write_text(json.dumps({"step": 15000}))
        (checkpoint.parent / "last").symlink_to(checkpoint.name)
        training = {"dataset": {"repo_id": f"gloves/{TASK}_state"}, "steps": 15000, "batch_size": 64, "seed": 0}
        (found[model] / "train_config.json").write_text(json.dumps(training))
    calibrate(found["expert_flow"])
    return found


def run(monkeypatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["train_models.py", f"--task={TASK}", *arguments])
    main()


def test_every_folder_gets_a_card_and_is_pushed_whole(folders, online, monkeypatch, capsys):
    run(monkeypatch)
    for model, folder in folders.items():
        assert f"`gloves/{TASK}_state`" in (folder / CARD_NAME).read_text(), model
    assert not online.repositories
    run(monkeypatch, "--push=tester")
    printed = capsys.readouterr().out
    for model, folder in folders.items():
        repo_id = f"tester/gloves_{TASK}_{model}"
        files = online.repositories["models", repo_id].files
        assert files == {file.name: file.read_bytes() for file in folder.iterdir()}
        card = ModelCard(files[CARD_NAME].decode())
        used = "--policy.adapter" if model == "expert_flow" else "--policy.path"
        assert f"{used}={repo_id}" in card.text and "15,000 steps of 64 items" in card.text
        assert f"{online.url}/{repo_id}" in printed
    assert Calibration.load(f"tester/gloves_{TASK}_expert_flow").episodes == (7, 8)


@pytest.mark.parametrize("missing", ["card", "calibration"])
def test_what_is_not_ready_is_not_pushed(folders, online, monkeypatch, missing):
    Models(TASK, None, 1).make(list(KINDS))
    file = folders["expert_flow"] / (CARD_NAME if missing == "card" else CALIBRATION_NAME)
    file.unlink()
    with pytest.raises(SystemExit, match=f"there is no .*{file.name}: make the models first, make models TASK={TASK}"):
        run(monkeypatch, "--push=tester")
    assert not online.repositories


def test_weights_that_are_not_the_calibrated_ones_are_not_pushed(folders, online, monkeypatch):
    run(monkeypatch)
    other = save_policy(Path("other"), "gloves_expert_flow", seed=3) / "model.safetensors"
    other.replace(folders["expert_flow"] / other.name)
    with pytest.raises(SystemExit, match="the calibration belongs to other weights"):
        run(monkeypatch, "--models", "expert_flow", "--push=tester")
    assert not online.repositories
