import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from lerobot_gloves.benchmark.rows import read_rows
from lerobot_gloves.commands import main

QUICK = ["--env.type=gloves_slalom", "--env.episode_length=20", "--episodes=3"]


@pytest.fixture
def options(tmp_path: Path, agent: str, adapter: str) -> list[str]:
    return [*QUICK, f"--agent={agent}", f"--adapter={adapter}", f"--output_dir={tmp_path / 'rows'}"]


def gloves(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    """Run the command in this process; what it says at its end."""
    monkeypatch.setattr(sys, "argv", ["gloves", *arguments])
    try:
        main()
    except SystemExit as end:
        return str(end.code)
    return ""


def start(*arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", "from lerobot_gloves.commands import main; main()", *arguments],
        env=os.environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Whoever runs the tests in the background has them ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def wait_for_rows(process: subprocess.Popen, folder: Path, count: int) -> None:
    while len(list(folder.glob("*.json"))) < count and process.poll() is None:
        time.sleep(0.1)  # pytest's own timeout ends this


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    for row in rows:
        row.pop("seconds")
        for episode in row["episodes"]:
            episode.pop("milliseconds")
    return rows


def test_bench_then_report(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix = ["--perturbations=[none, slow]", '--methods=[none, "feeg:start=0.5+gate"]', "--seeds=[0, 1]"]
    assert gloves(monkeypatch, "bench", *options, *matrix) == ""
    printed = capsys.readouterr().out
    rows = read_rows(tmp_path / "rows")
    assert len(rows) == 8
    assert [episode["seed"] for episode in rows[-1]["episodes"]] == [10100, 10101, 10102]
    assert printed.startswith("## gloves_slalom, test split")

    assert gloves(monkeypatch, "report", f"--rows={tmp_path / 'rows'}", f"--output={tmp_path / 'new' / 'r.md'}") == ""
    assert capsys.readouterr().out == printed
    assert (tmp_path / "new" / "r.md").read_text() == printed


def test_running_again_runs_what_is_missing(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert gloves(monkeypatch, "bench", *options) == ""
    assert gloves(monkeypatch, "bench", *options, "--num_workers=2") == "", "nothing is missing"
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "rows").iterdir()}
    assert gloves(monkeypatch, "bench", *options, "--perturbations=[none, laggy]") == ""
    after = {file: file.stat().st_mtime_ns for file in (tmp_path / "rows").iterdir()}
    assert len(after) == 2 and before.items() <= after.items()
    assert "made with episodes=3" in gloves(monkeypatch, "bench", *options, "--episodes=4")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            "--perturbations=[none, nosied]",
            "unknown perturbation 'nosied': choose from laggy, noised, none, shift, slow",
        ),
        ('--perturbations=["noised:std=1"]', "perturbation 'noised' has no option 'std': choose from sigma"),
        ("--methods=[none, feg]", "unknown method 'feg': choose from feeg, fpas, none"),
        ('--methods=["feeg:start=2"]', "FEEG: start is 2.0, but must lie in [0, 1]"),
        ("--methods=[none+gate]", "nothing that a gate could hold back"),
        ("--methods=[]", "methods is empty"),
        ("--score=likely", "unknown score 'likely': choose from reverse"),
        ("--score=reverse:steps=3", "not calibrated for score 'reverse:steps=3'"),
        ("--split=train", "unknown split 'train': choose from test, validation"),
        ("--episodes=101", "episodes is 101, but must lie between 1 and 100"),
        ("--seeds=[0, 100]", "seed is 100, but must lie between 0 and 99"),
        ("--agent=no/thing", "--agent=no/thing is no checkpoint's folder"),
        ("--adapter=/no/thing", "--adapter=/no/thing is no checkpoint's folder"),
        ("--env.obs_type=touch", "Slalom has no obs_type 'touch'"),
        ("--num_workers=0", "num_workers is 0"),
    ],
)
def test_wrong_options_are_refused_before_anything_runs(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, wrong: str, message: str
) -> None:
    said = gloves(monkeypatch, "bench", *options, '--methods=["feeg:start=0.5+gate"]', wrong)
    assert message in said
    assert said.startswith("gloves bench: ") and "\n" not in said
    assert not list(tmp_path.rglob("*.json"))


def test_an_adapter_must_be_one(options: list[str], agent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said = gloves(monkeypatch, "bench", *options, f"--adapter={agent}", "--methods=[feeg]")
    assert "is a policy of type 'gloves_flow_policy', which cannot correct another one" in said


def test_a_failed_cell_stops_no_other(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Slalom has no action dimension 7, which only shows while the cell runs."""
    said = gloves(monkeypatch, "bench", *options, '--perturbations=["shift:dim=7", none]')
    assert said == "gloves bench: 1 cell(s) failed, see above; run the command again to try only those"
    assert "shift:dim=7 / none / seed 0 failed: ValueError: Shift: dim is 7" in capsys.readouterr().err
    assert [row["cell"]["perturbation"] for row in read_rows(tmp_path / "rows")] == ["none"]


def test_report_of_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert gloves(monkeypatch, "report", f"--rows={tmp_path}") == "gloves report: there are no rows to report"
    assert "is no folder" in gloves(monkeypatch, "report", f"--rows={tmp_path / 'none'}")


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_episodes(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers, killed with their parent by kill -9, then one process: as if one process had done it all."""
    matrix = ['--perturbations=[noised, "shift:dim=7"]', '--methods=[none, "feeg+gate"]', "--seeds=[0, 1, 2, 3, 4, 5]"]
    process = start("bench", *options, *matrix, "--num_workers=2")
    wait_for_rows(process, tmp_path / "rows", 2)
    process.kill()
    _, errors = process.communicate(timeout=60)  # returns when the last worker has let go of the pipe
    kept = read_rows(tmp_path / "rows")
    assert 2 <= len(kept) < 12
    assert "failed: ValueError: Shift: dim is 7" in errors, "a failure in a worker is told"

    assert "12 cell(s) failed" in gloves(monkeypatch, "bench", *options, *matrix)
    finished = read_rows(tmp_path / "rows")
    assert len(finished) == 12
    assert all(row in finished for row in kept)
    alone = tmp_path / "alone"
    assert "12 cell(s) failed" in gloves(monkeypatch, "bench", *options, *matrix, f"--output_dir={alone}")
    assert without_times(finished) == without_times(read_rows(alone))


@pytest.mark.slow
def test_ctrl_c_keeps_rows_and_leaves_no_process(tmp_path: Path, options: list[str]) -> None:
    process = start("bench", *options, f"--seeds={list(range(100))}", "--num_workers=2")
    wait_for_rows(process, tmp_path / "rows", 1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers as well
    _, errors = process.communicate(timeout=60)  # returns when the last worker has let go of the pipe
    assert process.returncode == 1
    assert errors.rstrip().endswith("gloves bench: interrupted")
    assert "Traceback" not in errors
    assert 0 < len(read_rows(tmp_path / "rows")) < 100


@pytest.mark.slow
def test_a_killed_worker_ends_the_run_and_keeps_rows(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill_one() -> None:
        while not list((tmp_path / "rows").glob("*.json")):
            time.sleep(0.05)
        multiprocessing.active_children()[0].kill()

    threading.Thread(target=kill_one, daemon=True).start()
    said = gloves(monkeypatch, "bench", *options, f"--seeds={list(range(100))}", "--num_workers=2")
    assert said.startswith("gloves bench: a worker process was killed, perhaps for memory; finished cells are kept")
    assert 0 < len(read_rows(tmp_path / "rows")) < 100
    assert multiprocessing.active_children() == []
