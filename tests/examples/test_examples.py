"""Each example runs as it stands, and shows what it says."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = {path.stem for path in (ROOT / "examples").glob("*.py")}


def run(name: str, *arguments: str) -> str:
    """What an example prints."""
    command = [sys.executable, ROOT / "examples" / f"{name}.py", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_every_example_has_a_test():
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert tested >= EXAMPLES and len(EXAMPLES) >= 6


def test_score_a_chunk():
    one, five = [list(map(float, re.findall(r" (\d+\.\d)", line))) for line in run("score_a_chunk").splitlines()]
    assert one == [0.0, 0.0, 0.0], "one step of a flow without error"
    assert five[0] < min(five[1:])


def test_calibrate_and_gate():
    _, expert, shifted = run("calibrate_and_gate").splitlines()
    passed = [float(re.search(r"([\d.]+) % pass", line)[1]) for line in (expert, shifted)]
    assert passed[0] == pytest.approx(95, abs=2.5) and passed[1] < 30


def test_edit_a_chunk():
    before, *after = [float(re.search(r": ([+-][\d.]+)", line)[1]) for line in run("edit_a_chunk").splitlines()]
    assert len(after) == 3 and all(abs(one) < abs(before) for one in after)


@pytest.mark.slow
def test_wrap_a_policy():
    raw, corrected = [list(map(int, re.findall(r"\d+", line))) for line in run("wrap_a_policy").splitlines()]
    assert raw[2:] == [0, 0] and 0 < corrected[2] < corrected[3]
    assert corrected[0] > raw[0]


@pytest.mark.slow
def test_train_an_adapter(tmp_path):
    *_, last = run("train_an_adapter", str(tmp_path)).splitlines()
    adapter = Path(re.search(r"adapter=(\S+)", last)[1])
    assert (adapter / "model.safetensors").is_file() and (adapter / "calibration.safetensors").is_file()


def test_read_a_log(tmp_path):
    chunk = {"episode": 0, "step": 0, "edited": False, "distance": 0.0, "milliseconds": 2.0}
    lines = [chunk, chunk | {"step": 10, "edited": True, "distance": 0.5, "milliseconds": 4.0}, chunk | {"episode": 3}]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert run("read_a_log", str(tmp_path / "log.jsonl")).splitlines() == [
        "episode 0: 1 of 2 chunks edited, the first at step 10, by 0.50 on average, 3.0 ms a chunk",
        "episode 3: 0 of 1 chunks edited, by 0.00 on average, 2.0 ms a chunk",
    ]
