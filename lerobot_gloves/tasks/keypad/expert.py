"""A scripted person who presses the button that is due, never twice alike."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_gloves.tasks.jostling import JostledExpert
from lerobot_gloves.tasks.keypad.environment import MAX_DELTA
from lerobot_gloves.tasks.keypad.scene import BAR_HALF, BUTTON_TOP, BUTTONS, FRAME_TOP, PITCH, PRESS

CLEAR = FRAME_TOP + 0.008
"""Height of the tip from which on the expert moves over the frame, metres."""

WELL = 0.011
"""Sideways distance from a button's centre within which the expert goes down or stays down; the frame is at 16 mm."""

NEAR = 0.005
"""Sideways distance at which the expert has arrived above what it aims at, metres."""


class KeypadExpert(JostledExpert):
    """Rises, travels above the frame, goes down on the button that is due and presses it.

    Where to go follows from where the stylus is: below the frame's top and not on the button that is due, up; above
    it, toward the button, at a height that falls as it comes near; on the button, down. Its only memory is that a
    button which it has just pressed has to come up before it can be pressed again.

    What differs between presses: the point aimed at, the height of travel, how sideways the ways up and down are, the
    speed and how it drifts, and how far the stylus rises between two presses of one button. And the expert may first
    set out for another button and then change its mind, above the frame, so that the data show the way to any button
    from anywhere.

    The set-point is jostled, gently: an expert answers pushes that a policy, which decides ten actions at once, cannot
    foresee, so what a policy learns to do blindly is off by about as much as the robot is pushed in ten steps, and
    above a button the frame is 16 mm away.

    Args:
        rng: Source of all draws.
    """

    action_bound = MAX_DELTA
    jostled = 3
    haste_noise = 0.01
    drift_noise = 0.00007  # metres a step
    jitter_range = (0.0002, 0.0008)  # metres a step

    def _begin(self, mode: str) -> None:
        self._due = -1  # observations tell which button is due, whatever the mode
        self._rising = False

    def _plan(self, due: int, position: np.ndarray) -> None:
        """Draw what is particular to the next press."""
        rng = self._rng
        self._due = due
        self._aim = BUTTONS[due] + rng.uniform(-0.006, 0.006, 2)
        self._speed = rng.uniform(0.0026, 0.0034)
        self._height = rng.uniform(0.070, 0.095)
        self._turn = rng.uniform(0.043, 0.050)
        self._ramp = rng.uniform(0.006, 0.020)  # how far above the frame it moves sideways at full speed
        self._slope = rng.uniform(1.0, 4.0)  # of the way down
        self._detour: np.ndarray | None = None
        if rng.random() < 0.3:
            way = BUTTONS[rng.integers(len(BUTTONS))] - position[:2]
            self._detour = position[:2] + rng.uniform(0.2, 1.0) * way
            self._dip = rng.uniform(CLEAR, self._height)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next displacement of the set-point.

        Args:
            observation: Needs `agent_pos` (9,) and `goal` (9,).

        Returns:
            (3,) float32 (dx, dy, dz) in metres.
        """
        tip_height = float(observation["agent_pos"][2])
        position = np.asarray(observation["agent_pos"][3:6], dtype=np.float64)
        due = int(observation["goal"].argmax())
        if due != self._due:
            self._plan(due, position)
        at_due = bool(np.abs(position[:2] - BUTTONS[due]).max() < PITCH / 2 - BAR_HALF)
        if at_due and tip_height < BUTTON_TOP - PRESS:
            if not self._rising:
                self._plan(due, position)
            self._rising = True
        elif tip_height > self._turn or not at_due:
            self._rising = False

        direction = self._direction(position)
        action = self._speed * self._hurry() * direction / max(1.0, float(np.linalg.norm(direction)))
        return self._clipped(action)

    def _direction(self, position: np.ndarray) -> np.ndarray:
        """Where to go (3,), of length 1 or less where something is near."""
        sideways, height = position[:2], position[2]
        if self._detour is not None and height > CLEAR and np.linalg.norm(self._detour - sideways) < NEAR:
            self._detour = None
        aim, lowest = (self._aim, CLEAR) if self._detour is None else (self._detour, self._dip)
        way = aim - sideways
        distance = float(np.linalg.norm(way))
        way /= max(distance, NEAR)

        to_due = float(np.abs(sideways - BUTTONS[self._due]).max())
        if self._detour is None and (distance < NEAR or (height < CLEAR and to_due < WELL)):
            direction = np.array([*0.5 * way, 1.0 if self._rising else -1.0])
        else:
            wanted = min(self._height, lowest + self._slope * max(0.0, distance - NEAR))
            freedom = np.clip((height - FRAME_TOP - 0.004) / self._ramp, 0.0, 1.0)
            direction = np.array([*freedom * way, np.clip((wanted - height) / 0.008, -1.0, 1.0)])
        if height < CLEAR:
            off_centre = sideways - BUTTONS[np.abs(BUTTONS - sideways).max(axis=1).argmin()]
            distance = float(np.abs(off_centre).max())
            if distance < PITCH / 2:  # in a well: away from the frame beside it, the more the nearer
                direction[:2] -= np.clip((distance - 0.006) / 0.006, 0.0, 1.0) * off_centre / max(distance, NEAR)
        return direction
