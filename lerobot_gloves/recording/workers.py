"""Episodes staged by this process, or by several side by side."""

import multiprocessing
import multiprocessing.connection
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.recording import staging

type Stage = Callable[[Sequence[range]], Iterator[None]]
"""Plays and saves parts of a recording one after the other and yields behind each."""


def stage_all(stage: Stage, folder: Path, parts: Sequence[range], num_workers: int) -> Iterator[int]:
    """Stage the parts of a recording of which an episode is missing.

    Args:
        stage: Plays them; must survive pickling.
        folder: The staging folder.
        parts: The episodes, in the groups in which they are played.
        num_workers: Processes that play side by side.

    Yields:
        How many episodes there are, whenever that may have changed.

    Raises:
        RuntimeError: If a process failed; its error has been printed.
    """
    wanted = {index for part in parts for index in part}
    missing = [part for part in parts if not staging.staged(folder).issuperset(part)]
    if num_workers == 1:
        for _ in stage(missing):
            yield len(staging.staged(folder) & wanted)
        return
    context = multiprocessing.get_context("spawn")  # an OpenGL context does not survive a fork
    workers = [
        context.Process(target=_work, args=(stage, missing[i::num_workers], os.getpid()))
        for i in range(min(num_workers, len(missing)))
    ]
    for worker in workers:
        worker.start()
    try:
        while any(worker.is_alive() for worker in workers):
            multiprocessing.connection.wait([worker.sentinel for worker in workers if worker.is_alive()], 0.5)
            yield len(staging.staged(folder) & wanted)
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()
    if failed := [worker.exitcode for worker in workers if worker.exitcode]:
        raise RuntimeError(f"{len(failed)} of {len(workers)} recording processes failed; their errors are above")


def _work(stage: Stage, parts: Sequence[range], parent: int) -> None:
    """One process's share; ends early when the recording itself was killed."""
    register_third_party_plugins()
    for _ in stage(parts):
        if os.getppid() != parent:
            return
