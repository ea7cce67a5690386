"""What the page shows of a task and how its robot is steered, one class a task."""

from typing import Any, Protocol

import numpy as np
from lerobot.envs import EnvConfig

from lerobot_gloves.drive.can import CanView
from lerobot_gloves.drive.keypad import KeypadView
from lerobot_gloves.drive.slalom import SlalomView


class View(Protocol):
    """A task as a person meets it. Places are (right, down) on the top view, in metres.

    Attributes:
        scene: What stands on the top view whatever is asked for, as the page draws it: `bounds` (left, top, right,
            bottom), `circles` (right, down, radius), `lines` from place to place, each with a `kind`, `target_radius`,
            `keys`, which of `height` and `grip` have some, and `height`, the `range` of what is steered and `marks` in
            it by their names, where there is one; lengths in metres.
        faults: Specifications of perturbations that a person may drive against, by their names on the page.
    """

    scene: dict[str, Any]
    faults: dict[str, str]

    def steer(self, x: float, y: float, z: float = 0.0, grip: float = 0.0) -> np.ndarray:
        """The action (A,), float32, of a stick that is there, see `lerobot_gloves.drive.stick.Position`.

        What the task has no axis for is ignored.
        """
        ...

    def arrow(self, action: np.ndarray) -> tuple[float, float, float]:
        """Where the stick would be for an action (A,), without the fingers; beyond 1 if it is larger."""
        ...

    def place(self, observation: dict[str, Any]) -> tuple[float, float]:
        """Where what is steered is, by an observation of one environment."""
        ...

    def moment(self, observation: dict[str, Any]) -> dict[str, Any]:
        """What else the page shows at this step, by an observation of one environment.

        `height` of what is steered; `heights` of others by their names; `objects` that move (right, down, radius);
        `due`, the place of the target of the moment. Whatever a task does not have is left out.
        """
        ...

    def targets(self, task: str) -> list[tuple[float, float]]:
        """The places that a task string asks for, in their order."""
        ...

    def words(self, task: str) -> str:
        """The same as a sentence."""
        ...

    def ending(self, failure: str) -> str:
        """Why an episode failed, as a sentence, by the environment's word."""
        ...


VIEWS: dict[str, type[View]] = {"gloves_slalom": SlalomView, "gloves_keypad": KeypadView, "gloves_can": CanView}
"""By `--env.type`."""


def view_of(config: EnvConfig) -> View:
    """The view of a task.

    Raises:
        ValueError: If a person cannot steer it here.
    """
    if config.type not in VIEWS:
        raise ValueError(f"--env.type={config.type} cannot be driven: choose from {', '.join(VIEWS)}")
    return VIEWS[config.type]()
