"""Chosen action dimensions that are wrong: shifted, rotated into one another, of the wrong sign."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import rand
from lerobot_gloves.perturbations.base import Perturbation, check_dimension, check_finite, check_probability


@dataclass
class Shift(Perturbation):
    """A constant added to one action dimension over the whole chunk: a systematic bias."""

    # The action dimension, d.
    dim: int = 1
    # What is added, in raw action units.
    alpha: float = 0.005
    # Probability that a chunk is shifted, p_shift.
    p: float = 0.5

    def __post_init__(self) -> None:
        if self.dim < 0:
            raise ValueError(f"Shift: dim is {self.dim}, but must not be negative")
        check_finite("Shift", "alpha", self.alpha)
        check_probability("Shift", "p", self.p)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        check_dimension("Shift", "dim", self.dim, chunk)
        offset = torch.zeros(chunk.shape[-1], dtype=chunk.dtype, device=chunk.device)
        offset[self.dim] = self.alpha
        return torch.where(self._happens(self.p, chunk), chunk + offset, chunk)


@dataclass
class Rotated(Perturbation):
    """Two action dimensions rotated in their plane, all the time: the agent's frame is turned against the robot's."""

    # The action dimension that the rotation takes from.
    first: int = 0
    # The action dimension that it takes to: at 90 degrees, what was commanded along the first goes along the second.
    second: int = 1
    # The angle, in degrees.
    degrees: float = 20.0

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            if getattr(self, name) < 0:
                raise ValueError(f"Rotated: {name} is {getattr(self, name)}, but must not be negative")
        if self.first == self.second:
            raise ValueError(f"Rotated: first and second are both {self.first}, but must be two dimensions")
        check_finite("Rotated", "degrees", self.degrees)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        for name in ("first", "second"):
            check_dimension("Rotated", name, getattr(self, name), chunk)
        cosine, sine = math.cos(math.radians(self.degrees)), math.sin(math.radians(self.degrees))
        along, across = chunk[..., self.first], chunk[..., self.second]
        rotated = chunk.clone()
        rotated[..., self.first] = cosine * along - sine * across
        rotated[..., self.second] = sine * along + cosine * across
        return rotated


@dataclass
class Chatter(Perturbation):
    """The sign of one action dimension flips for some steps, again and again: a gripper that opens while it carries."""

    # The action dimension, counted from 0; -1 is the last, where a gripper mostly is.
    dim: int = -1
    # Probability that a flip begins at a step.
    p: float = 0.05
    # How many steps it lasts. One that begins during another goes on from its own step.
    steps: int = 5

    def __post_init__(self) -> None:
        if self.dim < -1:
            raise ValueError(f"Chatter: dim is {self.dim}, but must not be negative, or -1 for the last")
        check_probability("Chatter", "p", self.p)
        if self.steps < 1:
            raise ValueError(f"Chatter: steps is {self.steps}, but must be at least 1")

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        dim = self.dim if self.dim >= 0 else chunk.shape[-1] - 1
        check_dimension("Chatter", "dim", dim, chunk)
        begins = rand(chunk.shape[:2], self._generators(chunk), like=chunk) < self.p
        before = self._state(ran)
        left = torch.zeros_like(begins[:, 0], dtype=torch.long) if before is None else before
        self._states, signs = [left], []
        for begin in begins.unbind(dim=1):
            left = torch.where(begin, self.steps, (left - 1).clamp(min=0))
            self._states.append(left)
            signs.append(torch.where(left > 0, -1.0, 1.0))
        flipped = chunk.clone()
        flipped[..., dim] *= torch.stack(signs, dim=1).to(chunk.dtype)
        return flipped
