"""`gloves bench` in processes of its own: what is killed, interrupted or started twice."""

import contextlib
import os
import re
import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from lerobot_gloves.benchmark.folder import read_rows
from tests.benchmark.test_bench import gloves, without_times
from tests.preloaded import Started


def wait_for_rows(process: Started, folder: Path, count: int) -> None:
    while len(list(folder.glob("*.json"))) < count and process.poll() is None:
        time.sleep(0.1)  # pytest's own timeout ends this


@pytest.mark.slow
def test_killed_workers_cost_nothing_and_a_killed_run_goes_on(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both of two workers, then their parent, by kill -9; then one process: as if one process had done it all."""
    seeds = f"--seeds={list(range(5))}"
    matrix = ['--perturbations=[noised, "shift:dim=7"]', '--methods=[none, "feeg+gate"]', seeds]
    process = Started("gloves", "bench", *options, *matrix, "--num_workers=2")
    while not list((tmp_path / "rows").glob("*.failed")) and process.poll() is None:
        time.sleep(0.1)
    wait_for_rows(process, tmp_path / "rows", 1)
    process.send_signal(signal.SIGSTOP)  # so that it cannot give the first one's cell to the second
    (workers,) = [found for one in psutil.Process(process.pid).children() if (found := one.children())]
    assert len(workers) == 2
    for worker in workers:
        worker.kill()
    process.send_signal(signal.SIGCONT)
    # Once another row is there, what befell the workers and the failure before it have been told.
    wait_for_rows(process, tmp_path / "rows", len(list((tmp_path / "rows").glob("*.json"))) + 2)
    process.kill()
    _, errors = process.communicate(timeout=60)  # returns when the last worker has let go of the pipe
    assert "its worker was killed by signal 9 (SIGKILL); it is played again" in errors
    assert "failed: ValueError: Shift: dim is 7" in errors, "a failure in a worker is told"
    kept = read_rows(tmp_path / "rows")
    assert 2 <= len(kept) < 10

    assert "10 cell(s) failed" in gloves(monkeypatch, "bench", *options, *matrix)
    finished = read_rows(tmp_path / "rows")
    assert len(finished) == 10
    assert all(row in finished for row in kept)
    alone = tmp_path / "alone"
    assert "10 cell(s) failed" in gloves(monkeypatch, "bench", *options, *matrix, f"--output_dir={alone}")
    assert without_times(finished) == without_times(read_rows(alone))


@pytest.mark.slow
@pytest.mark.parametrize("num_workers", [1, 2])
def test_ctrl_c_keeps_rows_and_leaves_no_process(tmp_path: Path, options: list[str], num_workers: int) -> None:
    """With one worker, in the middle of a cell of this very process."""
    process = Started("gloves", "bench", *options, f"--seeds={list(range(100))}", f"--num_workers={num_workers}")
    wait_for_rows(process, tmp_path / "rows", 1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers as well
    _, errors = process.communicate(timeout=60)  # returns when the last worker has let go of the pipe
    assert process.returncode == 1
    assert errors.rstrip().endswith(
        "gloves bench: interrupted; finished cells are kept: run the command again to go on"
    )
    assert "Traceback" not in errors
    assert 0 < len(read_rows(tmp_path / "rows")) < 100
    assert {file.suffix for file in (tmp_path / "rows").iterdir()} == {".json"}


@contextlib.contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))


@pytest.mark.slow
def test_a_full_disk_ends_a_run_of_two_workers_and_keeps_rows(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No file may grow larger than a raw agent's row: its rows fit, those with histograms of scores do not."""
    options = [*options, "--episodes=20", "--perturbations=[noised]"]
    assert gloves(monkeypatch, "bench", *options, "--seeds=[0, 1]") == ""
    kept = {file: file.read_text() for file in (tmp_path / "rows").iterdir()}
    matrix = ['--methods=[none, "feeg+gate"]', "--seeds=[0, 1]", "--num_workers=2"]
    with files_of_at_most(max(map(len, kept.values())) + 200):
        said = gloves(monkeypatch, "bench", *options, *matrix)
    assert re.fullmatch(
        r"gloves bench: \[Errno 27\] File too large: '.*__feeg_gate__seed[01]\.json'; finished cells are kept: run the "
        "command again to go on",
        said.replace("feeg+gate", "feeg_gate"),
    )
    assert "Traceback" not in capsys.readouterr().err
    assert {file: file.read_text() for file in (tmp_path / "rows").iterdir()} == kept, "no parts, no locks"
    assert gloves(monkeypatch, "bench", *options, *matrix, "--num_workers=1") == ""
    assert len(read_rows(tmp_path / "rows")) == 4


@pytest.mark.slow
def test_two_runs_at_the_same_time_share_the_cells(tmp_path: Path, options: list[str]) -> None:
    """Every row's file is written once."""
    seeds = f"--seeds={list(range(12))}"
    runs = [Started("gloves", "bench", *options, seeds) for _ in range(2)]
    written: set[tuple[str, int]] = set()
    while any(run.poll() is None for run in runs):
        written |= {(file.name, file.stat().st_ino) for file in (tmp_path / "rows").glob("*.json")}
        time.sleep(0.01)
    assert [run.communicate()[1] for run in runs if run.returncode] == []
    assert len(written) == len(read_rows(tmp_path / "rows")) == 12
    assert {file.suffix for file in (tmp_path / "rows").iterdir()} == {".json"}
