import importlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.plan import finished_cells
from lerobot_gloves.benchmark.play import Failed, play
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.report.summary import summarise
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.benchmark.rows import ROWS, planned, write

RAW, GATED = Cell("none", "none", 0), Cell("noised:sigma=0.005", "feeg:start=0.5", 1, gate=True)


def test_a_row_comes_back_with_all_that_it_takes_to_repeat_it(tmp_path: Path, setup: Setup) -> None:
    write(tmp_path, setup, GATED)
    (row,) = read_rows(tmp_path)
    assert row.cell == GATED
    assert row.episodes == (Episode(10000), Episode(10001))
    assert row.conditions | {"agent": 0, "adapter": 0} == {
        "env": {
            "type": "gloves_slalom",
            "task": "Slalom-v0",
            "obs_type": "state",
            "image_size": 256,
            "episode_length": 300,
            "mode": None,
            "render_mode": "rgb_array",
        },
        "agent": 0,
        "adapter": 0,
        "split": "test",
        "episodes": 2,
        "batch_size": 2,
        "perturbation": "noised:sigma=0.005",
        "editor": "feeg:start=0.5,steps=10,align=1.0",
        "gate": True,
        "score": "reverse:steps=1",
        "alpha": 0.05,
    }
    assert row.conditions["agent"] == checkpoint_hash(setup.agent)
    assert row.conditions["adapter"] == checkpoint_hash(setup.adapter)
    assert row.checkpoints == {"agent": setup.agent, "adapter": setup.adapter}
    for package in ("torch", "lerobot", "mujoco", "diffusers"):
        assert row.versions[package] == importlib.import_module(package).__version__.partition("+")[0]
    assert row.versions["robosuite"] == "1.5.1", "which pyproject.toml pins"
    assert {"python", "lerobot_policy_gloves"} <= row.versions.keys()


def test_a_failed_write_leaves_no_row(tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    write(tmp_path, setup, RAW)
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    monkeypatch.setattr("os.fsync", full)
    for cell in (RAW, GATED):
        with pytest.raises(OSError, match=rf"No space left on device: '.*{cell.column[:4]}.*\.json'"):
            write(tmp_path, setup, cell)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_checkpoint_is_its_content(tmp_path: Path, adapter: str) -> None:
    copy = Path(shutil.copytree(adapter, tmp_path / "copy"))
    assert checkpoint_hash(str(copy)) == checkpoint_hash(adapter)
    (copy / "README.md").write_text("what a card says changes no episode")
    assert checkpoint_hash(str(copy)) == checkpoint_hash(adapter)
    for name in ("model.safetensors", "calibration.safetensors", "config.json"):
        copy = Path(shutil.copytree(adapter, tmp_path / name))
        with (copy / name).open("ab") as file:
            file.write(b" ")
        assert checkpoint_hash(str(copy)) != checkpoint_hash(adapter), name


def test_finished_cells_are_those_with_a_row(tmp_path: Path, setup: Setup) -> None:
    assert finished_cells(tmp_path, planned(setup, RAW, GATED)) == set()
    write(tmp_path, setup, GATED)
    assert finished_cells(tmp_path, planned(setup, RAW, GATED)) == {GATED}
    assert finished_cells(tmp_path, planned(setup, RAW)) == set()


@pytest.mark.parametrize(
    ("options", "cell", "difference"),
    [
        ({"episodes": 3}, RAW, "episodes=2"),
        ({"env": SlalomEnv(episode_length=20)}, RAW, "env={'type': 'gloves_slalom'.* 'episode_length': 300"),
        ({"split": "validation"}, RAW, "split=test"),
        ({"alpha": 0.1}, Cell("laggy", GATED.editor, 7, gate=True), "alpha=0.05"),
        ({"score": "reverse:steps=5"}, GATED, "score=reverse:steps=1"),
    ],
)
def test_rows_made_otherwise_are_refused(
    tmp_path: Path, setup: Setup, options: dict, cell: Cell, difference: str
) -> None:
    """Also if the same cell is not asked for: they would stand in one table."""
    write(tmp_path, setup, GATED)
    other = Setup(**{**vars(setup), **options})
    with pytest.raises(ValueError, match=rf"holds a row of noised.*seed 1 made with .*{difference}.*choose another"):
        finished_cells(tmp_path, planned(other, cell))


def test_what_does_not_concern_a_row_may_differ(tmp_path: Path, setup: Setup) -> None:
    """The raw agent's rows have no adapter, alpha or score."""
    write(tmp_path, Setup(**{**vars(setup), "adapter": None, "alpha": 0.3}), RAW)
    assert finished_cells(tmp_path, planned(setup, RAW, GATED)) == {RAW}


def test_options_that_a_method_has_no_longer_are_a_difference(tmp_path: Path, setup: Setup) -> None:
    guided = Setup(**{**vars(setup), "options": {"adapter_overrides": ["--guidance=2"]}})
    write(tmp_path, guided, GATED)
    assert finished_cells(tmp_path, planned(guided, GATED)) == {GATED}
    for seed in (1, 2):
        with pytest.raises(ValueError, match=r"made with options={'adapter_overrides': \['--guidance=2'\]}"):
            finished_cells(tmp_path, planned(setup, replace(GATED, seed=seed)))


def test_a_second_checkpoint_is_its_content(tmp_path: Path, setup: Setup, align_flow: str) -> None:
    """Each perturbation may have one of its own."""
    options = {"adapter_overrides": [f"--agent_flow={tmp_path}/{{perturbation}}"]}
    setup, folder = Setup(**{**vars(setup), "options": options}), tmp_path / "rows"
    folder.mkdir()
    for name in ("noised", "laggy"):
        copy = shutil.copytree(align_flow, tmp_path / name)
        (copy / "calibration.safetensors").write_text(name)
    noised, laggy = Cell("noised:sigma=0.005", "ifae", 0), Cell("laggy", "ifae", 0)
    write(folder, setup, noised)
    assert finished_cells(folder, planned(setup, noised, laggy)) == {noised}
    write(folder, setup, laggy)
    assert len(summarise(read_rows(folder))) == 1
    (job,) = planned(setup, laggy)
    (tmp_path / "laggy" / "model.safetensors").write_text("trained anew")
    outcome = play(job)
    assert isinstance(outcome, Failed) and "the agent_flow" in outcome.reason
    with pytest.raises(ValueError, match=r"a row of laggy / ifae / seed 0 made with agent_flow="):
        finished_cells(folder, planned(setup, noised, laggy))


@pytest.mark.parametrize("text", ["", "{}", '{"cell": {"seed": 1}}', "[1]"])
def test_a_file_that_is_no_row_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "notes.json").write_text(text)
    with pytest.raises(ValueError, match=r"notes\.json is not a row of gloves bench"):
        read_rows(tmp_path)


def test_labels_name_what_is_compared(tmp_path: Path, setup: Setup) -> None:
    """Two methods under one label, or the same perturbation at two strengths, would stand in one column or line."""
    named = replace(GATED, task="slalom", perturbation_label="noised", label="FEEG+gate")
    write(tmp_path, setup, named)
    (file,) = tmp_path.iterdir()
    assert file.name == "slalom__noised__FEEG+gate__seed1.json"
    assert json.loads(file.read_text())["cell"] == {
        "task": "slalom",
        "perturbation": "noised:sigma=0.005",
        "perturbation_label": "noised",
        "editor": "feeg:start=0.5",
        "gate": True,
        "label": "FEEG+gate",
        "seed": 1,
    }
    assert finished_cells(tmp_path, planned(setup, named, RAW)) == {named}
    for other in (replace(named, editor="feeg:start=0.4"), replace(named, perturbation="noised:sigma=0.1")):
        for seed in (1, 2):
            with pytest.raises(ValueError, match="choose another --output_dir"):
                finished_cells(tmp_path, planned(setup, replace(other, seed=seed)))
        assert finished_cells(tmp_path, planned(setup, replace(other, task="another"))) == set()


def test_cells_of_one_name_are_refused(setup: Setup) -> None:
    with pytest.raises(ValueError, match="have the same name: label them differently"):
        planned(setup, replace(RAW, label="a b"), replace(GATED, label="a_b", perturbation="none", seed=0))


def test_rows_are_plain_json(tmp_path: Path, setup: Setup) -> None:
    write(tmp_path, setup, GATED)
    (file,) = tmp_path.iterdir()
    assert file.name == "noised_sigma=0.005__feeg_start=0.5+gate__seed1.json"
    assert json.loads(file.read_text())["episodes"][1]["seed"] == 10001


def test_a_row_of_before_cells_knew_their_gate_loads_as_one_of_today() -> None:
    gated, *_, raw = ROWS
    row = Row.from_json(gated)
    assert (row.cell.editor, row.cell.gate, row.cell.column) == ("feeg", True, "feeg+gate")
    assert (row.conditions["editor"], row.conditions["gate"], row.specification) == ("feeg", True, "feeg+gate")
    row = Row.from_json(raw)
    assert row.cell.raw and not row.cell.gate
    assert (row.conditions["editor"], row.conditions["gate"]) == ("none", False)
