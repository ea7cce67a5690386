"""Stands where LeRobot's viewer is: what it was opened with, and what it was shown."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from lerobot_gloves.system import display


class Viewer:
    """Takes what would go to rerun, which need not be installed.

    Attributes:
        opened: The options of each opening.
        shown: What it was told, a step each.
        running: What the program had opened already; None for nothing.
    """

    def __init__(self, patch: pytest.MonkeyPatch):
        self.opened: list[dict[str, Any]] = []
        self.shown: list[dict[str, Any]] = []
        self.running: object = None
        asked = SimpleNamespace(get_global_data_recording=lambda: self.running)
        patch.setitem(sys.modules, "rerun", asked)  # type: ignore[arg-type]
        patch.setattr(display, "require_package", lambda *_, **__: None)
        patch.setattr(display, "init_visualization", lambda mode, **how: self.opened.append({"mode": mode, **how}))
        patch.setattr(display, "log_visualization_data", lambda mode, **data: self.shown.append(data))
