"""The schedule, with workers that play nothing: what runs side by side, what is left to others, what is tried again."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Self

import pytest

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.plan import Job
from lerobot_gloves.benchmark.play import Failed, make_row, play
from lerobot_gloves.benchmark.row import Row, row_file
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.benchmark.workers import Ended, Lost, Note, Outcome, play_all
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.system.locks import Lock
from lerobot_gloves.tasks.slalom import SlalomEnv

SETUP = Setup(env=SlalomEnv(), agent="agent", episodes=1)


def job(seed: int) -> Job:
    return Job(
        SETUP, Cell("none", "none", seed, task="slalom"), {"perturbation": "none", "editor": "none", "gate": False}
    )


def row(one: Job) -> Row:
    return make_row(one, seconds=1.0, episodes=[Episode(10000)])


class Scripted:
    """Workers whose outcomes are told beforehand; each cell that is begun must be locked, and no other."""

    def __init__(self, folder: Path, capacity: int, outcome: Callable[[Job], Outcome] = row):
        self.folder, self.capacity, self.outcome = folder, capacity, outcome
        self.running: deque[Job] = deque()
        self.begun: list[int] = []
        self.idle = 0

    def submit(self, job: Job) -> None:
        self.running.append(job)
        self.begun.append(job.cell.seed)
        assert len(self.running) <= self.capacity

    def outcomes(self, timeout: float) -> list[tuple[Job, Outcome]]:
        locked = {file.name for file in self.folder.glob("*.lock")}
        assert locked >= {row_file(self.folder, job.cell, ".lock").name for job in self.running}
        if not self.running:
            self.idle += 1
            return []
        one = self.running.popleft()
        return [(one, self.outcome(one))]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...


def test_every_cell_leaves_a_row_at_once_and_no_lock(tmp_path: Path) -> None:
    workers = Scripted(tmp_path, capacity=2)
    for count, event in enumerate(play_all([job(seed) for seed in range(5)], tmp_path, workers), start=1):
        assert event == Ended(job(count - 1).cell)
        assert len(read_rows(tmp_path)) == count
    assert workers.begun == [0, 1, 2, 3, 4]
    assert {file.suffix for file in tmp_path.iterdir()} == {".json"}


def test_a_lost_worker_costs_its_cell_one_attempt(tmp_path: Path) -> None:
    deaths = {1: 1, 2: 2}

    def outcome(one: Job) -> Outcome:
        if deaths.get(one.cell.seed):
            deaths[one.cell.seed] -= 1
            return Lost("its worker was killed by signal 9 (SIGKILL)")
        return row(one)

    events = list(play_all([job(seed) for seed in range(4)], tmp_path, Scripted(tmp_path, 2, outcome)))
    again = [event.text for event in events if isinstance(event, Note)]
    assert again == [
        f"slalom / none / agent / seed {s}: its worker was killed by signal 9 (SIGKILL); it is played again"
        for s in (1, 2)
    ]
    assert [row.cell.seed for row in read_rows(tmp_path)] == [0, 1, 3]
    (failure,) = [event.failure for event in events if isinstance(event, Ended) and event.failure]
    assert "seed 2 failed: its worker was killed by signal 9 (SIGKILL), 2 times, perhaps for memory" in failure


def test_a_failure_is_told_in_a_line_and_kept_whole(tmp_path: Path) -> None:
    def outcome(one: Job) -> Outcome:
        return Failed("ValueError: wrong", "Traceback ...\nValueError: wrong") if one.cell.seed == 1 else row(one)

    events = list(play_all([job(seed) for seed in range(3)], tmp_path, Scripted(tmp_path, 1, outcome)))
    log = tmp_path / "slalom__none__agent__seed1.failed"
    assert [event.failure for event in events] == ["", f"{job(1).cell} failed: ValueError: wrong ({log})", ""]
    assert "Traceback ...\nValueError: wrong" in log.read_text()
    # It is over once the cell has been played.
    assert list(play_all([job(1)], tmp_path, Scripted(tmp_path, 1))) == [Ended(job(1).cell)]
    assert {file.suffix for file in tmp_path.iterdir()} == {".json"}


def test_what_another_run_plays_is_left_to_it(tmp_path: Path) -> None:
    """It finishes one of its cells, and dies over the other."""
    theirs = {seed: Lock(row_file(tmp_path, job(seed).cell, ".lock")) for seed in (0, 1)}
    assert all(lock.acquire() for lock in theirs.values())
    workers = Scripted(tmp_path, capacity=2)
    events = play_all([job(seed) for seed in range(4)], tmp_path, workers)
    assert [next(events) for _ in range(2)] == [Ended(job(2).cell), Ended(job(3).cell)]
    assert next(events) == Note("another run plays the last 2 cell(s): waiting for it")
    row(job(0)).save(tmp_path)
    for lock in theirs.values():
        lock.release()
    assert {event.cell.seed for event in events} == {0, 1}
    assert workers.begun == [2, 3, 1], "the finished one is not played again"


def test_a_row_that_cannot_be_written_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    events = play_all([job(seed) for seed in range(3)], tmp_path, Scripted(tmp_path, 1))
    next(events)
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*seed1\.json'"):
        list(events)
    assert [file.name for file in tmp_path.iterdir()] == ["slalom__none__agent__seed0.json"], "rows kept, locks gone"


def test_a_checkpoint_that_has_changed_is_not_played(tmp_path: Path, agent: str) -> None:
    setup = Setup(env=SlalomEnv(), agent=agent, episodes=1)
    outcome = play(Job(setup, Cell("none", "none", 0), {"agent": "0" * 64}))
    assert isinstance(outcome, Failed)
    assert outcome.reason == f"ValueError: the agent {agent} is another one here than where the run began"
    assert outcome.details.startswith("Traceback")
