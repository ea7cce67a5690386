"""Worker processes that play cells and leave a row of each."""

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.benchmark.cell import Cell, Setup, run
from lerobot_gloves.benchmark.rows import Conditions, Row, write_row


def play(setup: Setup, cell: Cell, conditions: Conditions, folder: Path) -> Row:
    """Play a cell and write its row."""
    began = time.perf_counter()
    episodes = run(setup, cell)
    seconds = time.perf_counter() - began
    return write_row(folder, setup, cell, conditions=conditions, seconds=seconds, episodes=episodes)


def play_all(
    setup: Setup, planned: Mapping[Cell, Conditions], folder: Path, num_workers: int
) -> Iterator[tuple[Cell, Row | Exception]]:
    """Play cells, in this process or in several others.

    Args:
        setup: What the cells share.
        planned: The cells and their conditions.
        folder: Where their rows go.
        num_workers: Processes; with 1 it is this one.

    Yields:
        Each cell as it ends, with its row or with the error that it failed with.

    Raises:
        BrokenProcessPool: If a worker was killed.
    """
    if num_workers == 1:
        for cell, conditions in planned.items():
            try:
                yield cell, play(setup, cell, conditions, folder)
            except Exception as error:
                yield cell, error
        return
    context = multiprocessing.get_context("spawn")  # neither CUDA nor OpenGL survives a fork
    with ProcessPoolExecutor(num_workers, mp_context=context, initializer=begin_worker) as executor:
        # Workers are born here and inherit that Ctrl-C is not theirs: this process ends them.
        with interrupts_ignored():
            futures: dict[Future[Row], Cell] = {
                executor.submit(play, setup, cell, conditions, folder): cell for cell, conditions in planned.items()
            }
        try:
            for future in as_completed(futures):
                try:
                    outcome: Row | Exception = future.result()
                except BrokenProcessPool:
                    raise
                except Exception as error:
                    outcome = error
                yield futures[future], outcome
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def begin_worker() -> None:
    """Make a fresh process know the policies and environments, and end when its parent is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
    logging.disable(logging.WARNING)  # of which each cell has the same
    register_third_party_plugins()


@contextlib.contextmanager
def interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C meanwhile, and so do processes that are started meanwhile."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
