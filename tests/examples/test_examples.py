"""Each example runs as it stands, and shows what it says."""

import json
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.preloaded import server

ROOT = Path(__file__).parents[2]
EXAMPLES = {path.stem for path in (ROOT / "examples").glob("*.py")}


@pytest.fixture
def run(monkeypatch, capfd) -> Callable[..., str]:
    """Runs an example as `python examples/<name>.py`; returns what it prints."""

    def run(name: str, *arguments: str) -> str:
        monkeypatch.chdir(ROOT)
        monkeypatch.syspath_prepend(ROOT / "examples")
        monkeypatch.setattr(sys, "argv", [f"examples/{name}.py", *arguments])
        monkeypatch.setattr(sys, "executable", str(server() / "python"))  # beside which the commands lie that it starts
        runpy.run_path(f"examples/{name}.py", run_name="__main__")
        return capfd.readouterr().out

    return run


def test_every_example_has_a_test():
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert tested >= EXAMPLES and len(EXAMPLES) >= 6


def test_score_a_chunk(run):
    one, five = [list(map(float, re.findall(r" (\d+\.\d)", line))) for line in run("score_a_chunk").splitlines()]
    assert one == [0.0, 0.0, 0.0], "one step of a flow without error"
    assert five[0] < min(five[1:])


def test_calibrate_and_gate(run):
    _, expert, shifted = run("calibrate_and_gate").splitlines()
    passed = [float(re.search(r"([\d.]+) % pass", line)[1]) for line in (expert, shifted)]
    assert passed[0] == pytest.approx(95, abs=2.5) and passed[1] < 30


def test_edit_a_chunk(run):
    before, *after = [float(re.search(r": ([+-][\d.]+)", line)[1]) for line in run("edit_a_chunk").splitlines()]
    assert len(after) == 3 and all(abs(one) < abs(before) for one in after)


@pytest.mark.slow
def test_wrap_a_policy(run):
    raw, corrected = [list(map(int, re.findall(r"\d+", line))) for line in run("wrap_a_policy").splitlines()]
    assert raw[2:] == [0, 0] and 0 < corrected[2] < corrected[3]
    assert corrected[0] > raw[0]


@pytest.mark.slow
def test_train_an_adapter(run, tmp_path):
    *_, last = run("train_an_adapter", str(tmp_path)).splitlines()
    adapter = Path(re.search(r"adapter=(\S+)", last)[1])
    assert (adapter / "model.safetensors").is_file() and (adapter / "calibration.safetensors").is_file()


def test_read_a_log(run, tmp_path):
    chunk = {"episode": 0, "step": 0, "edited": False, "distance": 0.0, "milliseconds": 2.0}
    lines = [chunk, chunk | {"step": 10, "edited": True, "distance": 0.5, "milliseconds": 4.0}, chunk | {"episode": 3}]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert run("read_a_log", str(tmp_path / "log.jsonl")).splitlines() == [
        "episode 0: 1 of 2 chunks edited, the first at step 10, by 0.50 on average, 3.0 ms a chunk",
        "episode 3: 0 of 1 chunks edited, by 0.00 on average, 2.0 ms a chunk",
    ]
