"""Workers that are processes of this machine. Imports next to nothing, so that one minds its manners from birth."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Self

from lerobot_gloves.system.children import children
from lerobot_gloves.system.interrupts import interrupts_held, interrupts_ignored

if TYPE_CHECKING:
    from lerobot_gloves.benchmark.plan import Job
    from lerobot_gloves.benchmark.workers import Outcome


@dataclass(eq=False)
class Worker:
    """A process, what it hears and says, and the cell that it plays."""

    process: BaseProcess
    pipe: connection.Connection
    job: Job | None = None


class Processes:
    """Processes that play a cell each on one thread; one that is killed costs its cell, and another takes its place.

    Args:
        num_workers: How many.
    """

    def __init__(self, num_workers: int):
        self.capacity = num_workers
        self._workers: list[Worker] = []

    def submit(self, job: Job) -> None:
        """Give a cell to an idle process, or to a new one."""
        # One that died idle shall cost no cell an attempt.
        self._workers = [worker for worker in self._workers if worker.job is not None or worker.process.is_alive()]
        worker = next((one for one in self._workers if one.job is None), None) or self._begin()
        worker.job = job
        # If it has died since, its silence is heard in `outcomes`.
        with contextlib.suppress(OSError), interrupts_held():
            worker.pipe.send(job)

    def outcomes(self, timeout: float) -> Sequence[tuple[Job, Outcome]]:
        """What processes said, and which of them have fallen silent."""
        from lerobot_gloves.benchmark.workers import Lost

        busy = [worker for worker in self._workers if worker.job is not None]
        spoke = connection.wait([worker.pipe for worker in busy], timeout)
        found: list[tuple[Job, Outcome]] = []
        for worker in busy:
            if worker.pipe not in spoke:
                continue
            job, worker.job = worker.job, None
            assert job is not None
            try:
                with interrupts_held():
                    found.append((job, worker.pipe.recv()))
            except (EOFError, OSError):
                self._workers.remove(worker)
                worker.process.join()
                found.append((job, Lost(f"its worker {_death(worker.process.exitcode)}")))
        return found

    def _begin(self) -> Worker:
        context = children("lerobot_gloves.evaluation.preloaded")
        ours, theirs = context.Pipe()
        process = context.Process(target=serve, args=(theirs,))
        # It inherits that Ctrl-C is not for it: this process ends it.
        with interrupts_ignored():
            process.start()
        theirs.close()
        worker = Worker(process, ours)
        self._workers.append(worker)
        return worker

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            worker.pipe.close()
        self._workers.clear()


class ThisProcess:
    """This process, which plays one cell at a time."""

    capacity = 1

    def __init__(self) -> None:
        self._job: Job | None = None

    def submit(self, job: Job) -> None:
        """Note the cell, which `outcomes` plays."""
        self._job = job

    def outcomes(self, timeout: float) -> Sequence[tuple[Job, Outcome]]:
        """Play the cell."""
        from lerobot_gloves.benchmark.play import play

        job, self._job = self._job, None
        if job is None:
            threading.Event().wait(timeout)
            return []
        return [(job, play(job))]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass


def serve(pipe: connection.Connection) -> None:
    """Play the cells that come through a pipe, until this process is ended or its parent is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    prepare()
    from lerobot_gloves.benchmark.play import play

    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(play(job))


def prepare() -> None:
    """Make a worker know policies and environments, keep to its one core, and be silent."""
    os.environ["OMP_NUM_THREADS"] = "1"  # read once, when torch and numpy are imported
    logging.disable(logging.WARNING)  # each cell has the same ones
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()


def _death(exitcode: int | None) -> str:
    if exitcode is not None and exitcode < 0:
        return f"was killed by signal {-exitcode} ({signal.Signals(-exitcode).name})"
    return f"ended with status {exitcode}"
