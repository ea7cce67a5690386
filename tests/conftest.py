"""What every test runs under: offline, one thread, rendering without a display; and a command line in this process."""

import logging
import multiprocessing.forkserver
import os
import sys
from collections.abc import Callable, Iterator

# Before torch and huggingface_hub are imported, which read them once. `make test` sets them too.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("MUJOCO_GL", "egl")

import pytest
import torch

from tests.preloaded import fork_forkserver, remember_docstrings

torch.set_num_threads(1)
remember_docstrings()

pytest_plugins = ["tests.hub", "tests.straight"]


# Whatever forks from a server in a test (workers, vector environments) finds LeRobot imported: ten seconds of a core.
multiprocessing.set_forkserver_preload(["lerobot_gloves.evaluation.preloaded"])
if "PYTEST_XDIST_WORKER" in os.environ:  # the server is a fork of this worker, whose tests import LeRobot anyway
    import lerobot_gloves.evaluation.preloaded  # noqa: F401

    fork_forkserver()
    multiprocessing.forkserver.ensure_running()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests go first on every worker, so that none is left alone with one while the others have nothing to do.

    pytest-xdist deals the list out in parts of equal length, one a worker, before they steal from one another.
    """
    slow = _units([item for item in items if item.get_closest_marker("slow")])
    quick = [item for item in items if not item.get_closest_marker("slow")]
    left, workers = len(items), int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    items.clear()
    for worker in range(workers):
        length = left // (workers - worker)
        left -= length
        part = [item for unit in slow[worker::workers] for item in unit]
        more = max(0, length - len(part))
        items += part + quick[:more]
        del quick[:more]
    items += quick


def _units(items: list[pytest.Item]) -> list[list[pytest.Item]]:
    """Tests one by one, but those of a module that is marked `together` as one: its fixtures are made once."""
    units: dict[str, list[pytest.Item]] = {}
    for item in items:
        units.setdefault(
            item.nodeid.partition("::")[0] if item.get_closest_marker("together") else item.nodeid, []
        ).append(item)
    return list(units.values())


@pytest.fixture
def typed(monkeypatch) -> Callable[..., None]:
    """Makes its arguments what was typed after a command's name."""

    def as_typed(*arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["lerobot-command", *arguments])

    return as_typed


@pytest.fixture(autouse=True)
def logging_as_pytest_wants_it() -> Iterator[None]:
    """Commands set logging up for themselves, on the standard error of the test that runs them."""
    _quieten()
    yield
    _quieten()


def _quieten() -> None:
    root = logging.getLogger()
    root.handlers = [handler for handler in root.handlers if type(handler).__module__.startswith("_pytest")]
    root.setLevel(logging.WARNING)
