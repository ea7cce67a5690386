"""CAN at a person's controls: both bins from above, the height of the hand beside them."""

from typing import Any

import numpy as np

from lerobot_gloves.drive.facing import FacingView, rectangle
from lerobot_gloves.tasks.can.scene import (
    BIN_SIZE,
    DESTINATION_BIN,
    QUADRANTS,
    SOURCE_BIN,
    WALL_TOP,
    parse_mode,
    quadrant_centre,
)

SPEED = 0.75
"""Entry of the action for a key or a stick all the way out: the expert's."""
CAN_RADIUS = 0.033
ENDINGS = {
    "dropped": "The can fell beside the bins.",
    "wrong_quadrant": "The time is up, and the can lies in another quadrant.",
    "timeout": "The time is up.",
}


def _bin(middle: np.ndarray) -> list[dict]:
    x, y = middle[:2]
    down, right = BIN_SIZE / 2
    return rectangle(float(y - right), float(x - down), float(y + right), float(x + down))


class CanView(FacingView):
    """Both bins, the can, the quadrant that is asked for, and the hand with its height.

    Keys move the hand and open or close its fingers; nothing turns it, but what corrects may.
    """

    speed, axes, actions = SPEED, 3, 7
    scene: dict[str, Any] = {
        "bounds": [-0.55, -0.3, 0.58, 0.5],
        "circles": [],
        "lines": [
            *_bin(SOURCE_BIN),
            *_bin(DESTINATION_BIN),
            {
                "kind": "rule",
                "from": [float(DESTINATION_BIN[1]), float(DESTINATION_BIN[0] - BIN_SIZE[0] / 2)],
                "to": [float(DESTINATION_BIN[1]), float(DESTINATION_BIN[0] + BIN_SIZE[0] / 2)],
            },
            {
                "kind": "rule",
                "from": [float(DESTINATION_BIN[1] - BIN_SIZE[1] / 2), float(DESTINATION_BIN[0])],
                "to": [float(DESTINATION_BIN[1] + BIN_SIZE[1] / 2), float(DESTINATION_BIN[0])],
            },
        ],
        "keys": ["height", "grip"],
        "target_radius": 0.06,
        "height": {"range": [0.82, 1.12], "marks": {"walls": WALL_TOP}},
    }
    faults: dict[str, str] = {
        "laggy link": "laggy:p=0.75",
        "late by 0.2 s": "delayed:steps=4",
        "noise": "noised:sigma=0.4",
        "shift": "shift:dim=0,alpha=0.25,p=1.0",
    }

    def steer(self, x: float, y: float, z: float = 0.0, grip: float = 0.0) -> np.ndarray:
        action = super().steer(x, y, z)
        action[-1] = grip
        return action

    def place(self, observation: dict[str, Any]) -> tuple[float, float]:
        down, right = observation["agent_pos"][:2]
        return float(right), float(down)

    def moment(self, observation: dict[str, Any]) -> dict[str, Any]:
        x, y, height = (float(entry) for entry in observation["environment_state"][:3])
        return {
            "height": float(observation["agent_pos"][2]),
            "objects": [[y, x, CAN_RADIUS]],
            "heights": {"can": height},
        }

    def targets(self, task: str) -> list[tuple[float, float]]:
        down, right = quadrant_centre(parse_mode(task))
        return [(float(right), float(down))]

    def words(self, task: str) -> str:
        return (
            f"Pick up the can in the bin on the left and place it in the {QUADRANTS[parse_mode(task)]} of the bin on "
            "the right: open the fingers, go over the can and down, close them, go up, over, down, and let go."
        )

    def ending(self, failure: str) -> str:
        return ENDINGS.get(failure, failure)
