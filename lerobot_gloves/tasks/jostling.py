"""What no two demonstrations have alike: the expert's haste, and the pushes that the robot gets meanwhile."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

HASTE_MEMORY, DRIFT_MEMORY = 25, 30
"""After about how many control steps haste and drift have forgotten what they were."""


class JostledExpert(ABC):
    """A scripted person whose speed drifts, and whose robot is jostled while it demonstrates.

    Haste is the logarithm of the speed's drift: it multiplies the speed in `act`. Jostling is what `disturb` adds to an
    action: drift, which carries the robot off slowly, now one way and now another, and, in half of the episodes,
    jitter, drawn anew in each step and as strong throughout the episode. What is recorded is the expert's action and
    not the disturbed one, so that the data show the way back and not the push (as in DART, Laskey et al. 2017).

    Haste and each entry of the drift are Ornstein-Uhlenbeck processes in discrete time, x <- x - x / n + s w with w
    standard normal: of mean 0, and in the long run of standard deviation s / sqrt(1 - (1 - 1 / n)^2), which is s times
    3.6 for haste and 3.9 for drift.

    A subclass says how an episode begins (`_begin`) and what the expert wants (`act`), which asks `_hurry` for the
    haste once a step.

    Attributes:
        action_bound: What the entries of an action are clipped to, to either side.
        jostled: How many entries of an action are pushed, the first ones.
        haste_noise: s of the haste.
        drift_noise: s of the drift, in the units of an action.
        jitter_range: Smallest and largest standard deviation of the jitter of an entry, in the units of an action.

    Args:
        rng: Source of all draws.
    """

    action_bound: float
    jostled: int
    haste_noise: float
    drift_noise: float
    jitter_range: tuple[float, float]

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def reset(self, mode: str) -> None:
        """Begin an episode.

        Args:
            mode: What the environment asks for, its `task_description`.

        Raises:
            ValueError: If there is no such mode.
        """
        self._begin(mode)
        self._haste = 0.0
        self._drift: np.ndarray = np.zeros(self.jostled)
        self._jitter = self._rng.choice([0.0, 1.0]) * self._rng.uniform(*self.jitter_range)

    @abstractmethod
    def _begin(self, mode: str) -> None:
        """Draw what is particular to an episode that asks for this mode."""

    @abstractmethod
    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The action that the expert wants, (A,) float32, for an observation of the environment."""

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What reaches the robot in place of the expert's action (A,) while it is jostled, (A,) float32."""
        jitter, drift = self._push()
        return self._clipped(action + jitter + drift)

    def _hurry(self) -> float:
        """The factor of the speed in this step; the haste drifts on."""
        self._haste += -self._haste / HASTE_MEMORY + self.haste_noise * self._rng.standard_normal()
        return float(np.exp(self._haste))

    def _push(self) -> tuple[np.ndarray, np.ndarray]:
        """Jitter and drift of this step, (`jostled`,) each; the drift drifts on."""
        noise = self.drift_noise * self._rng.standard_normal(self.jostled)
        self._drift = self._drift + (-self._drift / DRIFT_MEMORY + noise)
        return self._jitter * self._rng.standard_normal(self.jostled), self._drift

    def _clipped(self, action: np.ndarray) -> np.ndarray:
        return np.clip(action, -self.action_bound, self.action_bound).astype(np.float32)
