"""Keypad at a person's controls: seen as its third-person camera sees it, the height of the stylus beside it."""

from typing import Any

from lerobot_gloves.drive.facing import FacingView, rectangle
from lerobot_gloves.tasks.keypad.scene import (
    BUTTON_HALF,
    BUTTON_TOP,
    BUTTONS,
    CENTRE,
    FLOOR,
    FRAME_TOP,
    PITCH,
    WORKSPACE,
)

SPEED = 0.003
"""Displacement of the set-point by a key or a stick all the way out, in metres a step on an axis: the expert's."""
EDGE = 1.5 * PITCH
ENDINGS = {
    "collision": "The stylus touched the frame.",
    "wrong_button": "Another button fired than the one that was due.",
    "timeout": "The time is up.",
}


class KeypadView(FacingView):
    """Nine buttons in their frame, those to press in their order, and the stylus's tip with its height."""

    speed, axes, actions = SPEED, 3, 3
    scene: dict[str, Any] = {
        "bounds": [CENTRE[1] - 0.1, CENTRE[0] - 0.1, CENTRE[1] + 0.1, CENTRE[0] + 0.1],
        "circles": [],
        "lines": [
            line
            for x, y in BUTTONS
            for line in rectangle(y - BUTTON_HALF, x - BUTTON_HALF, y + BUTTON_HALF, x + BUTTON_HALF)
        ]
        + rectangle(CENTRE[1] - EDGE, CENTRE[0] - EDGE, CENTRE[1] + EDGE, CENTRE[0] + EDGE),
        "keys": ["height"],
        "target_radius": BUTTON_HALF,
        "height": {"range": [FLOOR, float(WORKSPACE[1, 2])], "marks": {"frame": FRAME_TOP, "button": BUTTON_TOP}},
    }
    # An expert's action is a third of Slalom's.
    faults: dict[str, str] = {
        "laggy link": "laggy:p=0.75",
        "late by 0.2 s": "delayed:steps=4",
        "noise": "noised:sigma=0.002",
        "shift": "shift:dim=0,alpha=0.001,p=1.0",
    }

    def place(self, observation: dict[str, Any]) -> tuple[float, float]:
        down, right = observation["agent_pos"][:2]
        return float(right), float(down)

    def moment(self, observation: dict[str, Any]) -> dict[str, Any]:
        due = observation["goal"]
        found: dict[str, Any] = {"height": float(observation["agent_pos"][2])}
        if due.any():
            x, y = BUTTONS[int(due.argmax())]
            found["due"] = [float(y), float(x)]
        return found

    def targets(self, task: str) -> list[tuple[float, float]]:
        return [(float(BUTTONS[int(digit)][1]), float(BUTTONS[int(digit)][0])) for digit in task.split()]

    def words(self, task: str) -> str:
        names = [f"button {digit}" for digit in task.split()]
        asked = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and then {names[-1]}"
        return (
            f"Press {asked}, counted from 0 row by row from the top left. Travel above the frame, go down on the "
            "button that is due until it lights up, and up again."
        )

    def ending(self, failure: str) -> str:
        return ENDINGS.get(failure, failure)
