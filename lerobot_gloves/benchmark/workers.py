"""Cells played side by side, each of which leaves a row."""

import multiprocessing
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from lerobot_gloves.benchmark.cell import Cell, Setup, run
from lerobot_gloves.benchmark.processes import begin_worker, interrupts_ignored
from lerobot_gloves.benchmark.rows import Conditions, write_row


def play(setup: Setup, cell: Cell, conditions: Conditions, folder: Path) -> str | None:
    """Play a cell and write its row; returns in one line what went wrong, if anything did."""
    began = time.perf_counter()
    try:
        episodes = run(setup, cell)
        seconds = time.perf_counter() - began
        write_row(folder, setup, cell, conditions=conditions, seconds=seconds, episodes=episodes)
    except Exception as error:
        return f"{cell} failed: {type(error).__name__}: {' '.join(str(error).split())}"
    return None


def play_all(setup: Setup, planned: Mapping[Cell, Conditions], folder: Path, num_workers: int) -> Iterator[str | None]:
    """Play cells, in this process or in several others.

    Args:
        setup: What the cells share.
        planned: The cells and their conditions.
        folder: Where their rows go.
        num_workers: Processes; with 1 it is this one.

    Yields:
        What `play` returned, for each cell as it ends.

    Raises:
        BrokenProcessPool: If a worker was killed.
    """
    if min(num_workers, len(planned)) <= 1:
        for cell, conditions in planned.items():
            yield play(setup, cell, conditions, folder)
        return
    context = multiprocessing.get_context("spawn")  # neither CUDA nor OpenGL survives a fork
    with ProcessPoolExecutor(num_workers, mp_context=context, initializer=begin_worker) as executor:
        # Workers are born here and inherit that Ctrl-C is not theirs: this process ends them.
        with interrupts_ignored():
            futures = [executor.submit(play, setup, cell, conditions, folder) for cell, conditions in planned.items()]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise
