"""`gloves drive` as it is typed."""

import re
import sys

import pytest

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.commands import main
from lerobot_gloves.commands.drive import SHIPPED
from lerobot_gloves.system.locks import alone_with
from tests.builders import load


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--env.type=gloves_charger"], "--env.type=gloves_charger cannot be driven: choose from gloves_slalom"),
        (["--env.type=gloves_slalom", "--port=70000"], "port is 70000, but must lie between 0 and 65535"),
        (["--env.type=gloves_slalom", "--view=1"], "view is 1, but must lie between 64 and 2048"),
        (["--env.type=gloves_slalom", "--seed=-1"], "seed is -1, but must not be negative"),
        (["--env.type=gloves_slalom", "--host=192.0.2.1"], "cannot listen at 192.0.2.1:8765: "),
        (
            ["--env.type=gloves_slalom", "--port=0", "--policy.adapter=nowhere"],
            "--policy.adapter=nowhere is no checkpoint",
        ),
        (["--env.type=gloves_slalom", "--port=0", "--policy.method=fly"], "unknown method 'fly'"),
        (["--env.type=gloves_slalom", "--port=0", "--fault=hail"], "there is no fault 'hail': choose from none, laggy"),
        (["--env.type=gloves_slalom", "--study=3", "--output_dir=x"], "study is 3, but must be an even number"),
        (["--env.type=gloves_slalom", "--study=20"], "a study needs a folder: give both --study and --output_dir"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(monkeypatch, options, told):
    monkeypatch.setattr("sys.argv", ["gloves", "drive", *options])
    with pytest.raises(SystemExit) as error:
        main()
    assert str(error.value).startswith("gloves drive: ") and told in str(error.value)
    assert "\n" not in str(error.value)


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "lerobot_gloves.drive.server", None)
    monkeypatch.setattr("sys.argv", ["gloves", "drive", "--env.type=gloves_slalom"])
    with pytest.raises(SystemExit, match=r"pip install 'lerobot_policy_gloves\[drive\]'$"):
        main()


@pytest.mark.parametrize("task", SHIPPED)
def test_the_adapter_that_ships_is_small_calibrated_for_people_and_names_no_place_of_a_machine(task):
    files = list(SHIPPED[task].iterdir())
    assert sum(file.stat().st_size for file in files) <= 1_100_000
    assert not any(re.search(rb"\"[^\"\n]*(/home/|/root/|/tmp/|/work/|/Users/)", file.read_bytes()) for file in files)
    adapter, _ = load(SHIPPED[task])
    assert adapter.stride == 1 and "driven" in adapter.config.faults
    calibration = Calibration.load(SHIPPED[task])
    calibration.check(weights_hash(adapter.state_dict()))
    assert adapter.default_editor.startswith("feeg:") and adapter.gate_score == "reverse:steps=5"
    for score in ("reverse:steps=1", adapter.gate_score):  # what its own edit and its gate ask
        assert len(calibration.of(score, adapter.config.chunk_size)) >= 19


def test_a_study_that_runs_is_not_run_twice(monkeypatch, tmp_path):
    study = ["--env.type=gloves_slalom", "--port=0", "--study=2", f"--output_dir={tmp_path / 'mine'}"]
    monkeypatch.setattr("sys.argv", ["gloves", "drive", *study])
    with alone_with(tmp_path / "mine", ""), pytest.raises(SystemExit, match="is the folder of a study that runs"):
        main()
    assert list(tmp_path.iterdir()) == []
