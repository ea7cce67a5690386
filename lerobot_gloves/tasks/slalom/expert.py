"""A scripted person who steers the rod through any corridor, never twice alike."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_gloves.tasks.slalom.environment import MAX_DELTA
from lerobot_gloves.tasks.slalom.scene import ROW_Y, START, nearest_pillar, parse_mode

GAP_CENTRES = ((0.425, 0.575), (0.35, 0.5, 0.65), (0.275, 0.425, 0.575, 0.725))
"""Where each gap of each row is passed on average, metres."""


LOOKAHEAD = 0.035
"""How far ahead on its path the expert aims, metres along y."""


class SlalomExpert:
    """Follows a smooth path through a corridor, and steers back to it whenever it is off it.

    What differs between episodes: where each gap is passed, how the path bends between the rows, the speed and how
    it drifts. The path is a function x(y), so an action depends only on where the set-point is and on the episode's
    own draws.

    While it demonstrates, the robot is jostled: it drifts sideways, slowly now one way and now the other, and in half
    of the episodes it jitters. What is recorded is what the expert wanted to do, so that the data show the way back
    and not the push (as in DART, Laskey et al. 2017).

    Args:
        rng: Source of all draws.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def reset(self, mode: str) -> None:
        """Begin an episode.

        Args:
            mode: The corridor, such as "0 2 3".

        Raises:
            ValueError: If there is no such corridor.
        """
        rng = self._rng
        centres = [GAP_CENTRES[row][gap] for row, gap in enumerate(parse_mode(mode))]
        row_x = np.array(centres) + rng.uniform(-0.0125, 0.0125, 3)
        offsets = np.diff(row_x, prepend=START[0])
        # Between two rows the path changes x only from `begin` to `end`: a wide bend keeps clear of both rows.
        margins = rng.uniform(0.01, 0.03, (2, 3)) + 0.05 * np.abs(offsets)
        begin, end = np.array([START[1], *ROW_Y[:2]]) + margins[0], np.array(ROW_Y) - margins[1]
        self._bends = np.stack([begin, end, offsets])
        self._speed = rng.uniform(0.005, 0.006)
        self._haste = 0.0  # logarithm of the speed's drift
        self._sideways = 0.0  # what carries the robot off, metres a step
        self._jitter = rng.choice([0.0, 1.0]) * rng.uniform(0.0005, 0.002)  # metres a step and axis

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next displacement of the set-point.

        Args:
            observation: Needs `agent_pos` (4,), metres.

        Returns:
            (2,) float32 (dx, dy) in metres.
        """
        set_point = np.asarray(observation["agent_pos"][:2], dtype=np.float64)
        x, y = set_point
        direction = np.array([self._path(y + LOOKAHEAD) - x, LOOKAHEAD])
        direction /= np.linalg.norm(direction)

        rng = self._rng
        self._haste += -self._haste / 25 + 0.02 * rng.standard_normal()
        action = self._speed * np.exp(self._haste) * direction
        room, away = nearest_pillar(set_point)
        care = np.clip((0.03 - room) / 0.015, 0.0, 1.0)  # within 15 mm of a pillar, only along it or away from it
        action += care * max(0.0, -action @ away) * away
        return np.clip(action, -MAX_DELTA, MAX_DELTA).astype(np.float32)

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What reaches the robot in place of the expert's action (2,) while it is jostled, (2,) float32 in metres."""
        self._sideways += -self._sideways / 40 + 0.00035 * self._rng.standard_normal()
        disturbed = action + self._jitter * self._rng.standard_normal(2) + [self._sideways, 0.0]
        return np.clip(disturbed, -MAX_DELTA, MAX_DELTA).astype(np.float32)

    def _path(self, y: float) -> float:
        """Where the episode's path lies at y: its x in metres."""
        begin, end, offset = self._bends
        share = np.clip((y - begin) / (end - begin), 0.0, 1.0)
        return float(START[0] + (offset * share**2 * (3 - 2 * share)).sum())
