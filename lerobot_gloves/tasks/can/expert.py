"""A scripted person who carries the can to any quadrant, never twice alike."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_gloves.tasks.can.scene import RESTING_HEIGHT, parse_mode, quadrant_centre, quadrant_of
from lerobot_gloves.tasks.jostling import JostledExpert

PLACEMENT_NOISE = 0.05
"""Standard deviation of the place around the quadrant's centre, metres an axis."""
PLACEMENT_ROOM = np.array([0.04, 0.065])
"""Largest distance (x, y) from the centre at which the can is put down, clear of the walls, metres."""
REACH = 0.84
"""Largest distance of that place from the arm's foot `FOOT`: farther away the hand cannot point down, metres."""
FOOT = np.array([-0.5, -0.1])
ENTRANCE = np.array([0.1, 0.05])
"""Where the can comes into the destination bin (x, y) on average."""
CLEARANCE = 0.965
"""Height of the grip at which the can passes above the walls, metres."""
OPEN, HELD, EMPTY = 0.070, 0.054, 0.045
"""Distances of the fingers, metres: above the first they are open, between the others they hold a can."""
GAIN = 20.0
"""Action a metre of distance."""
TURN_GAIN = 0.4
"""Action a rad of orientation error."""
JOSTLING = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
"""Share of the jostling that reaches the hand's position and orientation."""


class CanExpert(JostledExpert):
    """Opens the hand above the can, lowers it, grips, lifts, carries, lowers, lets go and leaves.

    What comes next is decided anew in every step from what is observed: a can that slips or is pushed away is picked
    up again, and no step is counted. What differs between episodes: where in the quadrant the can is put down, how
    high and how much turned it is gripped, from which height it is let go, the heights and the bows of the ways there,
    the speed and how it drifts; and in three episodes of ten the expert first carries the can towards a quadrant drawn
    at random and then changes its mind, so that the data show the way to any quadrant from anywhere above the bin.

    Position and orientation of the hand are jostled; the fingers are left alone.

    Args:
        rng: Source of all draws.
    """

    action_bound = 1.0
    jostled = 6
    haste_noise = 0.02
    drift_noise = 0.02
    jitter_range = (0.05, 0.2)

    def _begin(self, mode: str) -> None:
        rng = self._rng
        self._quadrant = parse_mode(mode)
        centre = self._place = quadrant_centre(self._quadrant)
        reached = False
        while not reached:
            noise = PLACEMENT_NOISE * rng.standard_normal(2)
            self._place = centre + noise
            reached = bool((np.abs(noise) < PLACEMENT_ROOM).all() and np.linalg.norm(self._place - FOOT) < REACH)
        self._grip_height = rng.uniform(0.013, 0.021)  # above the can's centre
        self._yaw = rng.uniform(-0.2, 0.2)
        self._hover = rng.uniform(0.965, 1.01)
        self._carry = rng.uniform(1.0, 1.06)
        self._drop = rng.uniform(0.012, 0.03)
        self._bows = rng.normal(0.0, 0.25, 2)  # rad by which the ways to the can and to its place set out sideways
        self._via: np.ndarray | None = None
        if rng.random() < 0.3:
            self._via = ENTRANCE + rng.uniform(0.2, 0.8) * (quadrant_centre(int(rng.integers(4))) - ENTRANCE)
        self._speed = rng.uniform(0.65, 0.85)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next action.

        Args:
            observation: Needs `agent_pos` (8,) and, in `environment_state`, the can's position in the first three.

        Returns:
            (7,) float32 in [-1, 1].
        """
        state = np.asarray(observation["agent_pos"], dtype=np.float64)
        can = np.asarray(observation["environment_state"][:3], dtype=np.float64)
        grip, fingers = state[:3], state[7]

        aside = float(np.linalg.norm(can[:2] - grip[:2]))
        above = grip[2] - can[2]
        around = aside < 0.02 and 0.0 < above < 0.034
        held = around and EMPTY < fingers < HELD
        room = np.abs(can[:2] - quadrant_centre(self._quadrant)) < PLACEMENT_ROOM + 0.01
        arrived = can[2] < RESTING_HEIGHT + self._drop and quadrant_of(can) == self._quadrant

        if arrived and (room.all() or not held):
            closing, target = -1.0, grip.copy()
            if fingers > OPEN - 0.01:
                target[2] = CLEARANCE + 0.05
        elif held:
            closing, target = 1.0, self._carried_to(grip)
        elif around and fingers > EMPTY and (fingers < OPEN or (aside < 0.012 and above < self._grip_height + 0.008)):
            closing, target = 1.0, np.array([*can[:2], can[2] + self._grip_height])
        else:
            closing, target = -1.0, self._above(can, grip)
        move = GAIN * (target - grip)
        speed = self._speed * self._hurry()
        for part in (move[:2], move[2:]):
            part *= min(1.0, speed / max(float(np.linalg.norm(part)), 1e-9))
        return self._clipped(np.array([*move, *self._upright(state[3:7]), closing]))

    def _above(self, can: np.ndarray, grip: np.ndarray) -> np.ndarray:
        """Where to go (3,) in order to get around the can: over it first, then down."""
        aside = can[:2] - grip[:2]
        distance = float(np.linalg.norm(aside))
        low = can[2] + self._grip_height
        height = low + (self._hover - low) * np.clip((distance - 0.008) / 0.04, 0.0, 1.0)
        if distance > 0.02:
            aside = _turn(aside, self._bows[0]) * np.clip((grip[2] - 0.93) / 0.02, 0.0, 1.0)
        return np.array([*(grip[:2] + aside), height])

    def _carried_to(self, grip: np.ndarray) -> np.ndarray:
        """Where to go (3,) with the can: up, over its place, then down."""
        if self._via is not None and np.linalg.norm(self._via - grip[:2]) < 0.04:
            self._via = None
        aside = (self._place if self._via is None else self._via) - grip[:2]
        distance = float(np.linalg.norm(aside))
        low = RESTING_HEIGHT + self._grip_height
        height = low + (self._carry - low) * (1.0 if self._via is not None else np.clip((distance - 0.01) / 0.05, 0, 1))
        if distance > 0.05 or self._via is not None:
            aside = _turn(aside, self._bows[1]) * np.clip((grip[2] - CLEARANCE) / 0.02, 0.0, 1.0)
        return np.array([*(grip[:2] + aside), height])

    def _upright(self, quaternion: np.ndarray) -> np.ndarray:
        """The turn (3,) that makes the hand point down, with its yaw."""
        w, x, y, z = quaternion
        # Columns of the rotation matrix; a hand without yaw has the axes y, x, -z.
        axes = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
                [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
                [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        sine, cosine = np.sin(self._yaw), np.cos(self._yaw)
        wanted = np.array([[-sine, cosine, 0.0], [cosine, sine, 0.0], [0.0, 0.0, -1.0]])
        return TURN_GAIN * 0.5 * np.cross(axes, wanted).sum(axis=0)

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What reaches the robot in place of the expert's action (7,) while it is jostled, (7,) float32."""
        jitter, drift = self._push()
        disturbed = action.copy()
        disturbed[:6] += JOSTLING * (jitter + drift)
        return self._clipped(disturbed)


def _turn(vector: np.ndarray, bow: float) -> np.ndarray:
    """A vector (2,) turned by an angle (rad) that shrinks as the vector does."""
    angle = bow * np.clip((np.linalg.norm(vector) - 0.03) / 0.15, 0.0, 1.0)
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])
