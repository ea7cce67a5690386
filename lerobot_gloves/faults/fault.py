"""What a fault is, the units of its actions, and the draws that faults share."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import rand

type Range = tuple[float, float]
"""Between what a strength is drawn."""


CONSTANT = 1e-6
"""Up to this, a spread is rounding."""


@dataclass(frozen=True)
class Units:
    """Where the robot's own units lie among normalised actions.

    Attributes:
        zero: The normalised raw action 0, standing still, (A,).
        spread: The data's standard deviations, which a normalised 1 is in the robot's units, (A,). An entry of
            `CONSTANT` or less never changes: no fault does anything to it, and it is no measure for the others.
    """

    zero: Tensor
    spread: Tensor

    def alike(self) -> Tensor:
        """Factors (A,) that make a normalised strength equally large in the robot's units on every entry.

        The entry of middling spread keeps it.
        """
        return self.spread[self.varies].median() / self.spread if self.varies.any() else torch.ones_like(self.spread)

    @property
    def varies(self) -> Tensor:
        """Which entries change in the data, bool (A,)."""
        return self.spread > CONSTANT

    def raw(self, actions: Tensor) -> Tensor:
        """Normalised actions (..., A) in the robot's units."""
        return (actions - self.zero) * self.spread

    def normalised(self, raw: Tensor) -> Tensor:
        """The inverse of `raw`."""
        return self.zero + raw / self.spread


class Fault(ABC):
    """Something that may be wrong with an agent, of random strength."""

    @abstractmethod
    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        """What B agents with this fault would have proposed.

        Args:
            history: Normalised chunks of K decisions, (B, K, T, A), the oldest first.
            units: The robot's units among normalised ones.
            generator: Source of strengths and chances.

        Returns:
            A new tensor (B, K, T, A).
        """


def even(bounds: Range, like: Tensor, generator: torch.Generator | None, *, log: bool = False) -> Tensor:
    """One number an agent, (B, 1, 1, 1), evenly between bounds, or evenly between their logarithms."""
    low, high = (math.log(bound) for bound in bounds) if log else bounds
    drawn = low + (high - low) * rand((len(like), 1, 1, 1), generator, like=like)
    return drawn.exp() if log else drawn


def happens(p: Range, history: Tensor, generator: torch.Generator | None) -> Tensor:
    """Whether something happens to a chunk, bool (B, K, 1, 1), by a probability that each agent has for itself."""
    chance = even(p, history, generator)
    return rand((*history.shape[:2], 1, 1), generator, like=history) < chance


def one_entry(history: Tensor, generator: torch.Generator | None) -> Tensor:
    """1 at an entry of the action that each agent has for itself, else 0: (B, 1, 1, A)."""
    entry = (rand((len(history),), generator, like=history) * history.shape[-1]).long()
    return torch.nn.functional.one_hot(entry, history.shape[-1]).to(history)[:, None, None]
