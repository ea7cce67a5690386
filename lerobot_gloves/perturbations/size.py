"""Actions of the wrong size: scaled, cut off where they are small, rounded."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.perturbations.base import (
    Perturbation,
    check_finite,
    check_not_negative,
    check_positive,
    check_probability,
)


@dataclass
class Slow(Perturbation):
    """The whole chunk scaled: hesitation (or haste, for a factor above 1)."""

    # The factor.
    alpha: float = 0.5
    # Probability that a chunk is scaled, p_slow.
    p: float = 0.5

    def __post_init__(self) -> None:
        check_finite("Slow", "alpha", self.alpha)
        check_probability("Slow", "p", self.p)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        return torch.where(self._happens(self.p, chunk), self.alpha * chunk, chunk)


@dataclass
class Deadzone(Perturbation):
    """Entries smaller than a threshold become zero, the others stay: play, stiction."""

    # The threshold of an entry's magnitude, in raw action units.
    threshold: float = 0.002

    def __post_init__(self) -> None:
        check_not_negative("Deadzone", "threshold", self.threshold)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        return torch.where(chunk.abs() < self.threshold, torch.zeros_like(chunk), chunk)


@dataclass
class Quantised(Perturbation):
    """Entries rounded to the next multiple of a step: a coarse controller, a keyboard."""

    # The step, in raw action units.
    step: float = 0.004

    def __post_init__(self) -> None:
        check_positive("Quantised", "step", self.step)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        return torch.round(chunk / self.step) * self.step
