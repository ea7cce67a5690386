"""What the page shows of a task and how its robot is steered, one class a task."""

from typing import Any, Protocol

import numpy as np
from lerobot.envs import EnvConfig

from lerobot_gloves.drive.slalom import SlalomView


class View(Protocol):
    """A task as a person meets it. Places are (right, down) on the top view, in metres.

    Attributes:
        scene: What stands on the top view whatever is asked for, as the page draws it: `bounds` (left, top, right,
            bottom), `circles` (right, down, radius), and `lines` from place to place, each with a `kind`.
        faults: Specifications of perturbations that a person may drive against, by their names on the page.
    """

    scene: dict[str, Any]
    faults: dict[str, str]

    def steer(self, x: float, y: float) -> np.ndarray:
        """The action (A,), float32, of a stick that is at x to the right and y up, in [-1, 1] each."""
        ...

    def arrow(self, action: np.ndarray) -> tuple[float, float]:
        """Where the stick would be for an action (A,): the inverse of `steer`; beyond 1 if it is larger."""
        ...

    def place(self, observation: dict[str, Any]) -> tuple[float, float]:
        """Where what is steered is, by an observation of one environment."""
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


VIEWS: dict[str, type[View]] = {"gloves_slalom": SlalomView}
"""By `--env.type`."""


def view_of(config: EnvConfig) -> View:
    """The view of a task.

    Raises:
        ValueError: If a person cannot steer it here.
    """
    if config.type not in VIEWS:
        raise ValueError(f"--env.type={config.type} cannot be driven: choose from {', '.join(VIEWS)}")
    return VIEWS[config.type]()
