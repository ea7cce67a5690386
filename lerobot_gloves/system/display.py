"""LeRobot's viewer, rerun: what is observed, proposed, executed, and thought of it, while it happens."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from lerobot.utils.import_utils import require_package
from lerobot.utils.visualization_utils import init_visualization, log_visualization_data
from torch import Tensor

VIEWER = "rerun"


class Display:
    """Streams the steps of one environment to rerun.

    The viewer is opened at the first step, unless the program has one already, as `lerobot-rollout --display_data=true`
    does: then the steps are shown in that.

    Args:
        ip: Of a viewer that runs already; None opens one on this computer.
        port: Of that viewer.

    Raises:
        ValueError: If one of them is given without the other.
        ImportError: If rerun is not installed.
    """

    def __init__(self, ip: str | None = None, port: int | None = None):
        if (ip is None) != (port is None):
            raise ValueError("a viewer elsewhere has an address and a port: give both display_ip and display_port")
        require_package("rerun-sdk", extra="viz", import_name=VIEWER)
        self._where: dict[str, Any] = {"ip": ip, "port": port}
        self._opened = False

    @classmethod
    def asked(cls, options: Any) -> "Display | None":
        """What options of the names `display_data`, `display_ip` and `display_port` ask for; None for nothing.

        Raises:
            ValueError: If they name a viewer and have nothing shown.
        """
        if options.display_data:
            return cls(options.display_ip, options.display_port)
        if options.display_ip is not None or options.display_port is not None:
            raise ValueError("display_ip and display_port name a viewer, but without display_data nothing is shown")
        return None

    def show(
        self, observation: Mapping[str, Any], proposed: Tensor, executed: Tensor, known: Mapping[str, float]
    ) -> None:
        """Show a step of the first environment of B.

        Args:
            observation: What they showed before it; of its entries the numbers (B, ...) and the pictures (B, C, H, W)
                in [0, 1] are shown.
            proposed: The actions that were proposed, raw, (B, A).
            executed: Those that are executed, (B, A).
            known: What is known of the proposal, by name, such as its score.
        """
        if not self._opened:
            self._open()
        shown: dict[str, Any] = {
            key: _shown(value[0])
            for key, value in observation.items()
            if isinstance(value, Tensor) and value.ndim in (2, 4)
        }
        shown |= {f"gloves.{name}": value for name, value in known.items()}
        acted = {"proposed": proposed[0].numpy(force=True), "executed": executed[0].numpy(force=True)}
        log_visualization_data(VIEWER, observation=shown, action=acted)

    def _open(self) -> None:
        import rerun

        if rerun.get_global_data_recording() is None:
            init_visualization(VIEWER, session_name="gloves", **self._where)
        self._opened = True


def _shown(value: Tensor) -> np.ndarray:
    if value.ndim == 3 and value.is_floating_point():
        value = (255 * value).round().clamp(0, 255).to(torch.uint8)
    return value.numpy(force=True)
