"""Where somebody who drives wants to go, by what the page shows; one class a task."""

from typing import Any, Protocol

import numpy as np

from lerobot_gloves.drive.view import View
from lerobot_gloves.tasks.can.expert import CLEARANCE, HELD
from lerobot_gloves.tasks.can.scene import RESTING_HEIGHT
from lerobot_gloves.tasks.keypad.expert import CLEAR
from lerobot_gloves.tasks.keypad.scene import BUTTON_TOP, PRESS
from lerobot_gloves.tasks.slalom.scene import ROW_Y

FAR = 100.0
"""Steps of a way of which nobody asks how long it is."""


class Pilot(Protocol):
    """What is to be done next.

    Args:
        view: The task's.
        asked: The task string.
    """

    def __init__(self, view: View, asked: str) -> None: ...

    def wants(self, seen: dict[str, Any], coming: np.ndarray) -> tuple[np.ndarray, float]:
        """A way and what the fingers shall do.

        Args:
            seen: An observation, by which only what the page shows is known.
            coming: The sum (A,) of the actions that were commanded since, as far as they are reckoned with.

        Returns:
            The way (right, up on the picture, up in height) in steps of a key held, 0 where no key is needed; and the
            fingers, -1 to open, 1 to close.
        """
        ...


class SlalomPilot:
    """In front of each row sideways to its gap, then through."""

    near = 0.08  # before a row the rod only moves sideways until it faces the gap, metres
    behind = 0.05  # past a row it may move sideways again
    aligned = 0.012

    def __init__(self, view: View, asked: str) -> None:
        self._view, self._gaps = view, [down for _, down in view.targets(asked)]
        self._step = float(view.steer(1.0, 0.0)[1])

    def wants(self, seen: dict[str, Any], coming: np.ndarray) -> tuple[np.ndarray, float]:
        right, down = self._view.place(seen)
        down, right = down + coming[0], right + coming[1]
        ahead = [i for i, row in enumerate(ROW_Y) if right < row + self.behind]
        if not ahead:
            return np.array([FAR, 0.0, 0.0]), 0.0
        aside, room = self._gaps[ahead[0]] - down, ROW_Y[ahead[0]] - self.near - right
        if abs(aside) < self.aligned:
            return np.array([FAR, 0.0, 0.0]), 0.0
        return np.array([min(max(room, 0.0), abs(aside)), -aside, 0.0]) / self._step, 0.0


class KeypadPilot:
    """Up, above the button that is due, down until it lights up."""

    travel = 0.060  # lowest height to move sideways at, metres
    over = 0.007  # from the button's centre, metres

    def __init__(self, view: View, asked: str) -> None:
        self._view, self._rising = view, False
        self._step = float(view.steer(1.0, 0.0)[1])

    def wants(self, seen: dict[str, Any], coming: np.ndarray) -> tuple[np.ndarray, float]:
        moment, (right, down) = self._view.moment(seen), self._view.place(seen)
        if "due" not in moment:
            return np.zeros(3), 0.0
        height = moment["height"] + coming[2]
        aside = np.array([moment["due"][0] - right - coming[1], down + coming[0] - moment["due"][1]])
        at_due = float(np.abs(aside).max()) < self.over
        if moment["height"] < BUTTON_TOP - PRESS:  # pressed: what is due is another one, or the same once more
            self._rising = True
        elif height > BUTTON_TOP + 0.004:
            self._rising = False
        if self._rising or (height < CLEAR and not at_due):
            return np.array([0.0, 0.0, max(self.travel - height, self._step)]) / self._step, 0.0
        if at_due:
            return np.array([0.0, 0.0, -FAR]), 0.0
        aside = np.where(np.abs(aside) < self.over / 2, 0.0, aside)
        return np.array([*aside, max(0.0, self.travel - height)]) / self._step, 0.0


class CanPilot:
    """Over the can, down, grip, up, over the quadrant, down, let go, up."""

    metres = 0.0153  # that an action of 1 moves the hand in a step
    over_can, over_place = 0.010, 0.035
    hover = 0.965

    def __init__(self, view: View, asked: str) -> None:
        self._view, (self._place,) = view, view.targets(asked)
        self._step = self.metres * float(view.steer(1.0, 0.0)[1])
        self._fingers = -1.0

    def wants(self, seen: dict[str, Any], coming: np.ndarray) -> tuple[np.ndarray, float]:
        moment, (right, down) = self._view.moment(seen), self._view.place(seen)
        (can_right, can_down, _), can_height = moment["objects"][0], moment["heights"]["can"]
        fingers = float(seen["agent_pos"][7])  # the camera shows them
        held = fingers < HELD and abs(can_right - right) + abs(can_down - down) < 0.04 and moment["height"] > can_height
        back, over, up = self.metres * coming[:3]
        right, down, height = right + over, down + back, moment["height"] + up
        placed = abs(can_right - self._place[0]) < 0.09 and abs(can_down - self._place[1]) < 0.07
        if placed and can_height < RESTING_HEIGHT + 0.02:  # let go, and away
            self._fingers = -1.0
            return np.array([0.0, 0.0, max(CLEARANCE + 0.05 - height, 0.0) if fingers > HELD + 0.01 else 0.0]), -1.0
        aim, near = (self._place, self.over_place) if held else ((can_right, can_down), self.over_can)
        aside = np.array([aim[0] - right, down - aim[1]])
        there = bool((np.abs(aside) < near).all())
        if held:
            self._fingers = 1.0
            low = RESTING_HEIGHT + 0.018 if there else CLEARANCE + 0.03
        elif there and moment["height"] - can_height < 0.03:
            self._fingers = 1.0
            return np.zeros(3), 1.0
        else:
            self._fingers = -1.0
            low = can_height + 0.015 if there else self.hover
        rise = low - height
        if not there and height < self.hover - 0.02:
            aside = np.zeros(2)  # first up, clear of walls and can
        aside = np.where(np.abs(aside) < near / 2, 0.0, aside)
        rise = 0.0 if abs(rise) < 0.006 else rise
        return np.array([*(np.zeros(2) if there else aside), rise]) / self._step, self._fingers


PILOTS: dict[str, type[Pilot]] = {
    "gloves_slalom": SlalomPilot,
    "gloves_keypad": KeypadPilot,
    "gloves_can": CanPilot,
}
"""By `--env.type`."""
