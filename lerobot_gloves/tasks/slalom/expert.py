"""A scripted person who steers the rod through any corridor, never twice alike."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_gloves.tasks.slalom.environment import MAX_DELTA
from lerobot_gloves.tasks.slalom.scene import ROW_Y, START, nearest_pillar, parse_mode

GAP_CENTRES = ((0.425, 0.575), (0.35, 0.5, 0.65), (0.275, 0.425, 0.575, 0.725))
"""Where each gap of each row is passed on average, metres."""


class SlalomExpert:
    """Follows a smooth path through a corridor, and steers back to it whenever it is off it.

    What differs between episodes: where each gap is passed, how the path bends between the rows, the speed and how
    it drifts. The path is a function x(y), so an action depends only on where the set-point is and on the episode's
    own draws.

    While it demonstrates, the robot is jostled: slow sideways pushes of a few centimetres, and in half of the episodes
    a jitter. What is recorded is what the expert wanted to do, so that the data show the way back and not the push
    (as in DART, Laskey et al. 2017).

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
        self._speed = rng.uniform(0.005, 0.007)
        self._lookahead = rng.uniform(0.04, 0.06)
        self._drift = 0.0  # of the logarithm of the speed
        self._push_starts = np.cumsum(rng.exponential(20.0, 12) + 20.0) - 20.0
        self._push_sizes = rng.uniform(0.01, 0.035, 12) * rng.choice([-1.0, 1.0], 12)
        self._push_steps = rng.uniform(10.0, 25.0, 12)
        self._jitter = rng.choice([0.0, 1.0]) * rng.uniform(0.001, 0.004)  # metres a step and axis
        self._step = 0

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The next displacement of the set-point.

        Args:
            observation: Needs `agent_pos` (4,), metres.

        Returns:
            (2,) float32 (dx, dy) in metres.
        """
        set_point = np.asarray(observation["agent_pos"][:2], dtype=np.float64)
        x, y = set_point
        nearest_row = min(abs(y - row) for row in ROW_Y)
        ahead = self._lookahead * (0.5 + 0.5 * min(nearest_row / 0.07, 1.0))  # firmer next to pillars
        direction = np.array([self._path(y + ahead) - x, ahead])
        direction /= np.linalg.norm(direction)

        rng = self._rng
        self._drift += -self._drift / 25 + 0.03 * rng.standard_normal()
        action = self._speed * np.exp(self._drift) * direction
        self._step += 1
        room, away = nearest_pillar(set_point)
        care = np.clip((0.03 - room) / 0.015, 0.0, 1.0)  # within 15 mm of a pillar, only along it or away from it
        action += care * max(0.0, -action @ away) * away
        return np.clip(action, -MAX_DELTA, MAX_DELTA).astype(np.float32)

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What reaches the robot in place of the expert's action (2,) while it is jostled, (2,) float32 in metres."""
        disturbed = action + self._jitter * self._rng.standard_normal(2) + [self._push(), 0.0]
        return np.clip(disturbed, -MAX_DELTA, MAX_DELTA).astype(np.float32)

    def _path(self, y: float) -> float:
        """Where the episode's path lies at y: its x in metres."""
        begin, end, offset = self._bends
        share = np.clip((y - begin) / (end - begin), 0.0, 1.0)
        return float(START[0] + (offset * share**2 * (3 - 2 * share)).sum())

    def _push(self) -> float:
        """Sideways push of this step in metres: a few smooth bumps an episode."""
        phase = (self._step - self._push_starts) / self._push_steps
        bumps = np.where((phase > 0) & (phase < 1), 1 - np.cos(2 * np.pi * phase), 0.0)
        return float((self._push_sizes / self._push_steps * bumps).sum())
