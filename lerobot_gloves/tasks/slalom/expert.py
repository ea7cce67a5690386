"""A scripted person who steers the rod through any corridor, never twice alike."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from lerobot_gloves.tasks.jostling import JostledExpert
from lerobot_gloves.tasks.slalom.environment import MAX_DELTA
from lerobot_gloves.tasks.slalom.scene import GAPS, GOAL_Y, START, nearest_pillar, parse_mode

GAP_CENTRES = ((0.425, 0.575), (0.35, 0.5, 0.65), (0.275, 0.425, 0.575, 0.725))
"""Where each gap of each row is passed on average, metres."""

AISLE_Y = (-0.215, -0.01, 0.17)
"""Where the expert moves sideways on average, before each row, metres."""

SPACING = 0.002
"""Distance of the points that make up a path, metres."""

LOOKAHEAD = 10
"""How many points ahead on its path the expert aims."""


class SlalomExpert(JostledExpert):
    """Moves sideways in the aisle before each row until it faces its gap, passes the gap, and so on.

    What differs between episodes: where each aisle and each gap is passed, the speed and how it drifts; and in every
    aisle the expert may first set out for another gap and then change its mind, so that the data show the way to
    any gap from anywhere in the aisle. Off its path it steers back to it. The set-point is jostled.

    Args:
        rng: Source of all draws.
    """

    action_bound = MAX_DELTA
    jostled = 2
    haste_noise = 0.01
    drift_noise = 0.0003  # metres a step
    jitter_range = (0.0005, 0.002)  # metres a step

    def _begin(self, mode: str) -> None:
        rng = self._rng
        x, corners = START[0], [START]
        for row, gap in enumerate(parse_mode(mode)):
            y = AISLE_Y[row] + rng.uniform(-0.008, 0.008)
            corners.append(np.array([x, y]))
            if rng.random() < 0.3:
                other = GAP_CENTRES[row][rng.integers(GAPS[row])]
                corners.append(np.array([x + rng.uniform(0.2, 1.0) * (other - x), y]))
            x = GAP_CENTRES[row][gap] + rng.uniform(-0.01, 0.01)
            corners.append(np.array([x, y]))
        corners.append(np.array([x, GOAL_Y + 0.1]))
        self._path = np.concatenate([_points(*leg) for leg in pairwise(corners)])
        self._passed = 0  # points of the path
        self._speed = rng.uniform(0.0065, 0.0072)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next displacement of the set-point.

        Args:
            observation: Needs `agent_pos` (4,), metres.

        Returns:
            (2,) float32 (dx, dy) in metres.
        """
        set_point = np.asarray(observation["agent_pos"][:2], dtype=np.float64)
        # Only a stretch ahead is searched: where the expert changed its mind, the path meets itself.
        stretch = self._path[self._passed : self._passed + 15]
        self._passed += int(np.linalg.norm(stretch - set_point, axis=1).argmin())
        aim = self._path[min(self._passed + LOOKAHEAD, len(self._path) - 1)] - set_point
        direction = aim / max(float(np.linalg.norm(aim)), SPACING)

        action = self._speed * self._hurry() * direction
        room, away = nearest_pillar(set_point)
        care = np.clip((0.03 - room) / 0.015, 0.0, 1.0)  # within 15 mm of a pillar, only along it or away from it
        action += care * max(0.0, -action @ away) * away
        return self._clipped(action)


def _points(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points (n, 2) every `SPACING` from `begin` up to `end`, which is left to the next leg."""
    n = max(1, round(float(np.linalg.norm(end - begin)) / SPACING))
    return begin + (end - begin) * np.arange(n)[:, None] / n
