"""Commands too large or too small, on one entry or all."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.fault import Fault, Range, Units, even, happens, one_entry
from lerobot_gloves.generators import rand


@dataclass(frozen=True)
class Scale(Fault):
    """Chunks scaled, hesitation and haste: some of them, or all."""

    # The factor.
    factor: Range = (0.1, 2.5)
    # Probability that a chunk is scaled.
    p: Range = (0.3, 1.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        scaled = units.zero + even(self.factor, history, generator, log=True) * (history - units.zero)
        return torch.where(happens(self.p, history, generator), scaled, history)


@dataclass(frozen=True)
class Offset(Fault):
    """A constant on one entry of the action, to either side: in some of the chunks, or all."""

    # How much, in units of the data's spread.
    size: Range = (0.2, 3.0)
    # Probability that a chunk is shifted.
    p: Range = (0.3, 1.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        side = torch.where(rand((len(history), 1, 1, 1), generator, like=history) < 0.5, -1.0, 1.0).to(history)
        shift = side * even(self.size, history, generator) * one_entry(history, generator)
        return torch.where(happens(self.p, history, generator), history + shift, history)


@dataclass(frozen=True)
class DeadZone(Fault):
    """Entries closer to 0 than a threshold are 0."""

    # The threshold, in units of the data's spread.
    threshold: Range = (0.1, 1.5)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        small = (history - units.zero).abs() < even(self.threshold, history, generator, log=True)
        return torch.where(small, units.zero, history)


@dataclass(frozen=True)
class Quantised(Fault):
    """Entries rounded to multiples of a step."""

    # The step, in units of the data's spread.
    step: Range = (0.3, 2.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        step = even(self.step, history, generator, log=True)
        return units.zero + step * ((history - units.zero) / step).round()


@dataclass(frozen=True)
class Chatter(Fault):
    """One entry of the action has the other sign now and then, as a gripper that opens and closes by itself."""

    # Probability that an action's entry is turned round.
    p: Range = (0.05, 0.4)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        turned = rand((*history.shape[:3], 1), generator, like=history) < even(self.p, history, generator)
        return torch.where(turned & one_entry(history, generator).bool(), 2 * units.zero - history, history)
