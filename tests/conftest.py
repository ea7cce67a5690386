"""What every test runs under: offline, one thread, rendering without a display; and a command line in this process."""

import logging
import os
import sys
from collections.abc import Callable, Iterator

# Before torch and huggingface_hub are imported, which read them once. `make test` sets them too.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("MUJOCO_GL", "egl")

import pytest
import torch

torch.set_num_threads(1)

pytest_plugins = ["tests.straight"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests go first, so that no worker is left alone with one while the others have nothing to do."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture
def typed(monkeypatch) -> Iterator[Callable[..., None]]:
    """Makes its arguments what was typed after a command's name."""

    def as_typed(*arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["lerobot-command", *arguments])

    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield as_typed
    # LeRobot's commands set logging up for themselves, on this test's standard error.
    root.handlers, root.level = handlers, level
