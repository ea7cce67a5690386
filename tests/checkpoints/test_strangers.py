"""Checkpoints that this LeRobot cannot use as they are: one line, before anything runs, with file and remedy."""

import json
import runpy
import sys
from pathlib import Path

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from safetensors.torch import load_file, save_file

from lerobot_gloves.benchmark import play
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.held_out import training_config
from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.checkpoints.processors import MIGRATION
from lerobot_gloves.commands import bench, calibrate, record
from lerobot_gloves.recording import staging
from tests.builders import save_policy, write_dataset


def save_old(folder: Path, obs_type: str = "state") -> Path:
    """As LeRobot saved an agent before it had processors: its statistics are weights."""
    save_policy(folder, "act", obs_type)
    weights = load_file(folder / "model.safetensors")
    for file in folder.glob("policy_*processor*"):
        for key, value in (load_file(file) if file.suffix == ".safetensors" else {}).items():
            name, _, statistic = key.rpartition(".")
            into = "unnormalize_outputs" if "postprocessor" in file.name else "normalize_inputs"
            weights[f"{into}.buffer_{name.replace('.', '_')}.{statistic}"] = value.clone()
        file.unlink()
    save_file(weights, folder / "model.safetensors")
    return folder


@pytest.fixture
def old_agent(tmp_path) -> Path:
    return save_old(tmp_path / "old")


def said(main, typed, *options: str) -> str:
    typed(*options)
    with pytest.raises(SystemExit) as exit:
        main()
    line = str(exit.value.code)
    assert "\n" not in line
    return line


def remedy(folder: Path) -> str:
    return (
        f"{folder} was saved by an older LeRobot, with its normalisation among the weights and no "
        f"policy_preprocessor.json: run python -m {MIGRATION} --pretrained-path {folder} --output-dir <folder>, "
        "and name that folder"
    )


def test_record_says_it_before_anything_is_written(old_agent, tmp_path, typed):
    root = tmp_path / "data" / "noised"
    options = [f"--agent={old_agent}", "--dataset.repo_id=me/noised", f"--dataset.root={root}"]
    line = said(record.main, typed, "--env.type=gloves_slalom", *options)
    assert line == f"gloves record: {remedy(old_agent)}"
    assert not root.exists() and not staging.staging_folder(root).exists()


def test_bench_says_it_once_before_the_first_cell(old_agent, tmp_path, typed, monkeypatch, capsys):
    monkeypatch.setattr(play, "run", lambda *_: pytest.fail("a cell was played"))
    options = [f"--agent={old_agent}", f"--output_dir={tmp_path / 'rows'}", "--seeds=[0, 1]", "--num_workers=1"]
    line = said(bench.main, typed, "--env.type=gloves_slalom", "--env.episode_length=5", *options)
    assert line == f"gloves bench: gloves_slalom / agent: {remedy(old_agent)}"
    assert "older LeRobot" not in "".join(capsys.readouterr())


def test_the_remedy_works(tmp_path, monkeypatch):
    """The command of the line, as it stands there."""
    agent = save_old(tmp_path / "old", "pixels_agent_pos")
    python, option, module, *words = remedy(agent).partition("run ")[2].partition(", and")[0].split()
    assert (python, option) == ("python", "-m")
    monkeypatch.setattr(sys, "argv", [module, *(word.replace("<folder>", str(tmp_path / "new")) for word in words)])
    monkeypatch.setattr("huggingface_hub.RepoCard.validate", lambda *_, **__: None)  # asks the Hub
    runpy.run_module(module, run_name="__main__")
    config = PreTrainedConfig.from_pretrained(tmp_path / "new")
    config.pretrained_path = tmp_path / "new"
    migrated = load_policy(config, "cpu").policy.state_dict()
    weights = load_file(agent / "model.safetensors")
    assert len(migrated) > 20 and all(torch.equal(value, weights[key]) for key, value in migrated.items())


def test_weights_of_another_form_are_told_with_their_file(tmp_path):
    folder = save_policy(tmp_path / "agent", "act")
    path = folder / "model.safetensors"
    whole = path.read_bytes()
    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path = folder
    weights = load_file(path)
    weights["model.action_head.bias"] = torch.zeros(7)
    for damage in (lambda: save_file(weights, path), lambda: path.write_bytes(whole[:-10])):
        damage()
        with pytest.raises(ValueError, match=f"^{path} does not hold the weights of the act beside it") as error:
            load_policy(config, "cpu")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"type": "act_of_tomorrow"}, r"Policy type 'act_of_tomorrow' .* is not registered\. Mend it, or install what"),
        ({"blur": 3}, r"its config\.json is not one of this LeRobot .*The fields `blur` are not valid for ACTConfig"),
        ({"chunk_size": "long"}, r"is not one of this LeRobot .*'long'"),
    ],
)
def test_a_configuration_of_another_lerobot_is_told_with_its_file(tmp_path, entry, message):
    folder = save_policy(tmp_path / "agent", "act")
    path = folder / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entry))
    with pytest.raises(ValueError, match=message) as error:
        checkpoint_config("agent", folder)
    assert str(error.value).startswith(f"--agent={folder}: its config.json") and "\n" not in str(error.value)
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("entry", "named"),
    [
        ({"env": {"type": "my_robot_cell", "task": "weld"}}, "my_robot_cell"),
        ({"optimizer": {"type": "lion_of_tomorrow", "lr": 1e-3}}, "lion_of_tomorrow"),
        ({"wandb": {"plot": "everything"}}, "plot"),
    ],
)
def test_a_training_that_names_what_is_not_here_is_told_with_its_file(tmp_path, typed, entry, named):
    """And `gloves calibrate` scores nothing before."""
    write_dataset(tmp_path / "data")
    folder = save_policy(tmp_path / "adapter", "gloves_expert_flow")
    file = folder / "train_config.json"
    training = {
        "dataset": {"repo_id": "me/tiny", "root": str(tmp_path / "data"), "eval_split": 0.25},
        "policy": json.loads((folder / "config.json").read_text()),
        "output_dir": str(tmp_path / "run"),
    }
    file.write_text(json.dumps(training))
    assert training_config(folder).dataset.eval_split == 0.25
    file.write_text(json.dumps(training | entry))
    options = [f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={tmp_path / 'data'}"]
    line = said(calibrate.main, typed, *options)
    assert line.startswith(f"gloves calibrate: {file}, ") and named in line
    assert "install the package that brings" in line and "delete it from the file" in line
    assert not (folder / "calibration.safetensors").exists()
