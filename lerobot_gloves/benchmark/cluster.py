"""Workers that are Ray's, on this machine or on a cluster of others; Ray is an extra."""

import contextlib
import logging
import os
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from lerobot_gloves.benchmark.local_workers import prepare
from lerobot_gloves.benchmark.plan import Job
from lerobot_gloves.benchmark.play import Failed, play
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.benchmark.workers import Lost, Outcome
from lerobot_gloves.system.errors import one_line


class Cluster:
    """Ray tasks that play a cell each, on one core; their rows come back to this process, which writes them.

    On every machine that plays cells this package must be installed, and checkpoints must lie under the same paths, or
    on the Hub; each cell compares them with those here.

    Args:
        address: The cluster's, such as `10.0.0.1:6379` or `auto`; None starts one of this machine alone, for this run.
        num_workers: Cells that are played side by side at most; None for as many as there are cores.
        num_gpus: Share of a GPU that each takes.

    Raises:
        ImportError: If Ray is not installed.
        ConnectionError: If there is no cluster at that address, or it does not start.
    """

    def __init__(self, address: str | None, num_workers: int | None, num_gpus: float = 0.0):
        try:
            import ray
        except ImportError as error:
            raise ImportError(
                "--executor=ray needs Ray, which is an extra: pip install 'lerobot_policy_gloves[ray]'"
            ) from error
        self._ray, self._most = ray, num_workers
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        if address is not None:
            reach(address)
        start: dict[str, Any] = {"num_cpus": num_workers, "include_dashboard": False} if address is None else {}
        try:
            ray.init(address=address or "local", log_to_driver=False, logging_level=logging.ERROR, **start)
        except Exception as error:  # Ray's own come in many types
            raise ConnectionError(f"Ray did not come up: {one_line(error)}") from error
        # What becomes of a task whose worker dies is ours to decide: no retries. A worker plays any number of cells,
        # also with a GPU, where Ray would begin a new one for each: that takes longer than many a cell.
        self._play = ray.remote(num_cpus=1, num_gpus=num_gpus, max_retries=0, max_calls=0)(play_there)
        self._running: dict[Any, Job] = {}

    @property
    def capacity(self) -> int:
        """The cores of the cluster as it is now, or fewer."""
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        return cores if self._most is None else min(cores, self._most)

    def submit(self, job: Job) -> None:
        """Give a cell to whichever core is free."""
        self._running[self._play.remote(job, str(Path.cwd()))] = job

    def outcomes(self, timeout: float) -> Sequence[tuple[Job, Outcome]]:
        """What came back."""
        if not self._running:
            time.sleep(timeout)
            return []
        done, _ = self._ray.wait(list(self._running), timeout=timeout)
        return [(self._running.pop(reference), self._outcome(reference)) for reference in done]

    def _outcome(self, reference: Any) -> Outcome:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            reason = str(error).strip().splitlines()[-1]
            return Failed(f"it could not begin there: {reason}", str(error))
        except self._ray.exceptions.RayError as error:
            return Lost(f"its worker is gone ({type(error).__name__})")

    def __enter__(self) -> Self:
        # Ray tells on standard output what befell its workers, but that is for the table.
        self._told = contextlib.redirect_stdout(sys.stderr)
        self._told.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._ray.shutdown()
        self._told.__exit__(None, None, None)


def reach(address: str) -> None:
    """Find out in seconds what takes Ray itself several minutes: whether anybody answers at HOST:PORT.

    Raises:
        ConnectionError: If nobody does.
    """
    host, _, port = address.rpartition(":")
    if "://" in address or not port.isdigit():
        return  # Ray's other forms, such as auto
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        raise ConnectionError(f"there is no Ray cluster at {address}: {error}") from error


def play_there(job: Job, folder: str) -> Row | Failed:
    """Play a cell in a Ray worker, with the relative paths of the run's folder."""
    prepare()
    if Path(folder).is_dir():
        os.chdir(folder)
    return play(job)
