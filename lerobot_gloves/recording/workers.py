"""Episodes staged by this process, or by several side by side."""

import multiprocessing
import multiprocessing.connection
import sys
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.queues import SimpleQueue
from pathlib import Path

from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.recording import staging
from lerobot_gloves.system.children import children
from lerobot_gloves.system.interrupts import interrupts_ignored

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
        ChildProcessError: If a process failed. What it could not help, such as a full disk, is told here; of anything
            else it has printed a traceback.
    """
    wanted = {index for part in parts for index in part}
    missing = [part for part in parts if not staging.staged(folder).issuperset(part)]
    if num_workers == 1:
        for _ in stage(missing):
            yield len(staging.staged(folder) & wanted)
        return
    context = children("lerobot_gloves.evaluation.preloaded")
    told: SimpleQueue[str] = context.SimpleQueue()
    workers = [
        context.Process(target=_work, args=(stage, missing[i::num_workers], told))
        for i in range(min(num_workers, len(missing)))
    ]
    # They inherit that Ctrl-C is not for them: this process ends them.
    with interrupts_ignored():
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
        killed = next((f"killed by signal {-exitcode}" for exitcode in failed if exitcode < 0), "see above")
        reason = killed if told.empty() else told.get()
        raise ChildProcessError(f"{len(failed)} of {len(workers)} recording processes failed: {reason}")


def _work(stage: Stage, parts: Sequence[range], told: "SimpleQueue[str]") -> None:
    """One process's share; ends early when the recording itself was killed."""
    parent = multiprocessing.parent_process()
    try:
        register_third_party_plugins()
        for _ in stage(parts):
            if parent is None or not parent.is_alive():
                return
    except (OSError, ValueError, ImportError) as error:
        told.put(str(error)[:1000])  # nobody reads before all have ended, and a pipe holds only so much
        sys.exit(1)
