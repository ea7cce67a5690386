"""A scripted person at the keys: sees what the page shows, late, and presses one of eight directions and the others."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_gloves.drive.pilots import PILOTS
from lerobot_gloves.drive.stick import Position
from lerobot_gloves.drive.view import View

RATE = 20
"""Steps a second."""
LEAST, MOST = 0.2, 0.5
"""Between what a reaction time lies, in seconds."""
EIGHTH = math.pi / 4


@dataclass(frozen=True)
class Skill:
    """How well somebody drives.

    Attributes:
        reaction: Mean and standard deviation, over episodes, of the time from what is seen to a key, in seconds.
        foresees: Share of the way of that time, in which what was pressed goes on, that is reckoned with.
        thinks: Longest time that keys are held before they are thought over, in seconds.
        misjudges: Standard deviation of the error of a distance, as a share of it.
        slips: How often, in a second, a wrong neighbouring key is pressed.
    """

    reaction: tuple[float, float]
    foresees: float
    thinks: float
    misjudges: float
    slips: float


SKILLS = {
    "beginner": Skill(reaction=(0.44, 0.04), foresees=0.35, thinks=0.4, misjudges=0.3, slips=1.0),
    "ordinary": Skill(reaction=(0.37, 0.04), foresees=0.35, thinks=0.3, misjudges=0.3, slips=1.0),
    "practised": Skill(reaction=(0.30, 0.04), foresees=0.25, thinks=0.25, misjudges=0.3, slips=1.0),
}
"""Chosen so that alone they succeed neither always nor never; docs/drive.md says where the figures come from."""
SLIP = (2, 6)
"""For how many steps a wrong key is pressed, the least and one more than the most."""


class Driver:
    """One person in one episode.

    Args:
        task: The `--env.type`.
        view: The task's.
        skill: How well they drive.
        seed: Of the episode: the same person does the same where the same is seen.
        asked: The task string.
    """

    def __init__(self, task: str, view: View, skill: Skill, seed: int, asked: str) -> None:
        self._rng = np.random.default_rng([seed, *(round(1000 * part) for part in skill.reaction)])
        self._skill, self._view = skill, view
        self._pilot = PILOTS[task](view, asked)
        self.reaction = float(np.clip(self._rng.normal(*skill.reaction), LEAST, MOST))
        self._late = max(1, round(self.reaction * RATE))
        self._seen: deque[dict[str, Any]] = deque(maxlen=self._late + 1)
        self._sent: deque[np.ndarray] = deque(maxlen=self._late)
        self._keys: Position = (0.0, 0.0, 0.0, 0.0)
        self._slip: tuple[float, float] = (0.0, 0.0)
        self._holds = self._slips = 0

    def command(self, observation: dict[str, Any]) -> Position:
        """Where the stick is at this step.

        Args:
            observation: What one environment shows at this step.
        """
        self._seen.append(observation)
        if self._holds == 0:
            self._decide(self._seen[0])
        self._holds -= 1
        if self._slips == 0 and self._rng.random() < self._skill.slips / RATE:
            self._slips, self._slip = int(self._rng.integers(*SLIP)), self._neighbour(*self._keys[:2])
        x, y, z, grip = self._keys
        if self._slips:
            self._slips -= 1
            x, y = self._slip
        self._sent.append(self._view.steer(x, y, z, grip))
        return x, y, z, grip

    def _decide(self, seen: dict[str, Any]) -> None:
        """Press the keys for where to go from what was seen."""
        on_the_way = sum(self._sent, start=np.zeros_like(self._view.steer(0.0, 0.0)))
        way, grip = self._pilot.wants(seen, self._skill.foresees * on_the_way)
        way = way * (1 + self._skill.misjudges * self._rng.standard_normal(3))
        x = y = 0.0
        if length := math.hypot(way[0], way[1]):
            angle = round(math.atan2(way[1], way[0]) / EIGHTH) * EIGHTH
            x, y = (round(part, 9) for part in (math.cos(angle), math.sin(angle)))
        self._keys = (x, y, float(np.sign(way[2])), grip)
        wanted = max(length, abs(float(way[2])))
        self._holds = int(np.clip(round(wanted), 1, max(1, round(self._skill.thinks * RATE))))

    def _neighbour(self, x: float, y: float) -> tuple[float, float]:
        """A direction beside one; of none, any of the eight."""
        side = self._rng.choice([-1, 1]) if x or y else int(self._rng.integers(8))
        angle = math.atan2(y, x) + EIGHTH * side
        return round(math.cos(angle), 9), round(math.sin(angle), 9)
