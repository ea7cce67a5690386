"""Slalom at a person's controls: seen as its camera sees it, the goal to the right."""

from typing import Any

from lerobot_gloves.drive.facing import FacingView
from lerobot_gloves.tasks.slalom.expert import GAP_CENTRES
from lerobot_gloves.tasks.slalom.scene import GOAL_Y, PILLAR_RADII, PILLARS, ROW_Y, START, parse_mode

SPEED = 0.007
"""Displacement of the set-point by a stick all the way out, in metres a step. The expert is not faster, and a copilot
has seen nothing that is: at the largest action, 0.01, any command of a person would look wrong to it."""
GAPS = (("upper", "lower"), ("upper", "middle", "lower"), ("first", "second", "third", "last"))
"""What the gaps of each row are called, from the top of the picture."""
ENDINGS = {
    "collision": "The rod touched a pillar.",
    "wrong_corridor": "The rod passed a row through another gap than the one asked for.",
    "timeout": "The time is up.",
}


class SlalomView(FacingView):
    """Pillars, the gaps to pass, and the rod's tip."""

    speed, axes, actions = SPEED, 2, 2
    scene: dict[str, Any] = {
        "keys": [],
        "target_radius": 0.03,
        "bounds": [-0.37, 0.2, 0.42, 0.8],
        "circles": [[float(y), float(x), float(radius)] for (x, y), radius in zip(PILLARS, PILLAR_RADII, strict=True)],
        "lines": [
            {"kind": "goal", "from": [GOAL_Y, 0.2], "to": [GOAL_Y, 0.8]},
            {"kind": "start", "from": [float(START[1]), 0.2], "to": [float(START[1]), 0.8]},
        ],
    }
    # Of a command that a person holds, a fault lasts for single steps; strengths are those at which one notices it.
    faults: dict[str, str] = {
        "laggy link": "laggy:p=0.75",
        "late by 0.2 s": "delayed:steps=4",
        "noise": "noised:sigma=0.005",
        "shift": "shift:dim=0,alpha=0.003,p=1.0",
    }

    def place(self, observation: dict[str, Any]) -> tuple[float, float]:
        down, right = observation["agent_pos"][2:4]
        return float(right), float(down)

    def moment(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {}

    def targets(self, task: str) -> list[tuple[float, float]]:
        return [(ROW_Y[row], GAP_CENTRES[row][gap]) for row, gap in enumerate(parse_mode(task))]

    def words(self, task: str) -> str:
        first, second, third = (GAPS[row][gap] for row, gap in enumerate(parse_mode(task)))
        return (
            f"Steer the rod to the green line on the right: through the {first} gap of the first row, "
            f"the {second} gap of the second, the {third} gap of the third, counted from the top."
        )

    def ending(self, failure: str) -> str:
        return ENDINGS.get(failure, failure)
