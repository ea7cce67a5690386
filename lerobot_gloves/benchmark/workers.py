"""Cells played side by side, whoever plays them; each leaves a row as soon as it is finished."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.plan import Job
from lerobot_gloves.benchmark.play import Failed
from lerobot_gloves.benchmark.row import Row, row_file
from lerobot_gloves.system.locks import Lock

ATTEMPTS = 2
"""How often a cell is begun whose worker is killed every time."""


@dataclass(frozen=True)
class Lost:
    """A cell whose worker is gone.

    Attributes:
        reason: What became of it, in one line.
    """

    reason: str


type Outcome = Row | Failed | Lost


class Workers(Protocol):
    """Whoever plays cells: this process, others of this machine, or other machines."""

    @property
    def capacity(self) -> int:
        """How many cells they play side by side."""
        ...

    def submit(self, job: Job) -> None:
        """Begin to play a cell; there must be room for it."""
        ...

    def outcomes(self, timeout: float) -> Sequence[tuple[Job, Outcome]]:
        """What became of cells since the last call; waits that many seconds for some, at most."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None:
        """End all that still runs."""
        ...


@dataclass(frozen=True)
class Ended:
    """How a cell ended.

    Attributes:
        cell: The cell.
        failure: What went wrong, in one line; "" if it has a row now.
    """

    cell: Cell
    failure: str = ""


@dataclass(frozen=True)
class Note:
    """Something to tell the user meanwhile, in one line."""

    text: str


def play_all(jobs: Sequence[Job], folder: Path, workers: Workers, *, patience: float = 1.0) -> Iterator[Ended | Note]:
    """Play cells, each under a lock, and write their rows.

    A cell that another run is playing is left to it, and taken over if that run ends without a row of it.

    Args:
        jobs: The cells.
        folder: Where rows, locks and what is known of failures go.
        workers: Who plays them.
        patience: How many seconds pass before a cell that another run plays is looked at again.

    Yields:
        How each cell ended, as it does, and what else there is to tell.

    Raises:
        OSError: If a row or a lock cannot be written.
    """
    waiting, attempts = deque(jobs), Counter[Cell]()
    held: dict[Cell, Lock] = {}
    told = False
    try:
        while waiting or held:
            elsewhere: list[Job] = []
            while waiting and len(held) < workers.capacity:
                job = waiting.popleft()
                lock = Lock(row_file(folder, job.cell, ".lock"))
                if not lock.acquire():
                    elsewhere.append(job)
                elif row_file(folder, job.cell).exists():
                    lock.release()
                    yield Ended(job.cell)
                else:
                    held[job.cell] = lock
                    workers.submit(job)
            waiting.extend(elsewhere)
            if elsewhere and not held and not told:
                told = True
                yield Note(f"another run plays the last {len(waiting)} cell(s): waiting for it")
            for job, outcome in workers.outcomes(patience):
                if isinstance(outcome, Lost):
                    attempts[job.cell] += 1
                    if attempts[job.cell] < ATTEMPTS:
                        yield Note(f"{job.cell}: {outcome.reason}; it is played again")
                        workers.submit(job)
                        continue
                    outcome = Failed(f"{outcome.reason}, {ATTEMPTS} times, perhaps for memory", outcome.reason)
                ended = _keep(folder, job, outcome)
                held.pop(job.cell).release()
                yield ended
    finally:
        for lock in held.values():
            lock.release()


def _keep(folder: Path, job: Job, outcome: Row | Failed) -> Ended:
    """Write down what became of a cell."""
    log = row_file(folder, job.cell, ".failed")
    if isinstance(outcome, Failed):
        log.write_text(f"{job.cell} failed: {outcome.reason}\n\n{outcome.details}")
        return Ended(job.cell, f"{job.cell} failed: {outcome.reason} ({log})")
    outcome.save(folder)
    log.unlink(missing_ok=True)
    return Ended(job.cell)
