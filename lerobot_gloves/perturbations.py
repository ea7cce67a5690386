"""Perturbations that make a good agent imperfect (paper, appendix "Imitation Learning Policy with wrapper").

They act on raw action chunks (B, T, A), in the environment's units. Each environment draws from a generator of its
own, seeded by `reset`, so that what happens to it does not depend on the batch it runs in.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import randn, spawn


@dataclass
class Perturbation(ABC):
    """Something done to every chunk that an agent emits: a dataclass of numbers.

    Example:
        >>> perturbation = Noised(sigma=0.005)
        >>> perturbation.reset(batch_size=2, seed=0)
        >>> perturbation(torch.zeros(2, 10, 2)).shape
        torch.Size([2, 10, 2])
    """

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        """Begin an episode in each of `batch_size` environments.

        Args:
            batch_size: Number of environments B.
            seed: The run's seed.
            first_episode: Number of the first environment's episode; the others follow it.
        """
        self._spawned = spawn(seed, batch_size, first_episode=first_episode, stream=type(self).__name__)

    @abstractmethod
    def __call__(self, chunk: Tensor) -> Tensor:
        """Perturb chunks (B, T, A) in raw units; returns a new tensor of that shape."""

    def _generators(self, chunk: Tensor) -> list[torch.Generator]:
        """The generators, one per chunk.

        Raises:
            ValueError: If `reset` was not called, or for another number of environments.
        """
        spawned = getattr(self, "_spawned", [])
        if len(spawned) != chunk.shape[0]:
            raise ValueError(
                f"{type(self).__name__}: reset for {len(spawned)} environments, but got {chunk.shape[0]} chunks"
            )
        return spawned

    def _happens(self, probability: float, chunk: Tensor) -> Tensor:
        """One independent draw per environment, bool (B, 1, 1)."""
        drawn = [torch.rand((), generator=one).item() < probability for one in self._generators(chunk)]
        return torch.tensor(drawn, device=chunk.device)[:, None, None]


def _check_finite(owner: str, name: str, value: float) -> None:
    if not math.isfinite(value):
        raise ValueError(f"{owner}: {name} is {value}, but must be finite")


def _check_probability(owner: str, name: str, value: float) -> None:
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{owner}: {name} is {value}, but must lie in [0, 1]")


@dataclass
class Noised(Perturbation):
    """Gaussian noise on every action: imprecise, jittery control."""

    # Standard deviation, in raw action units.
    sigma: float = 0.005

    def __post_init__(self) -> None:
        _check_finite("Noised", "sigma", self.sigma)
        if self.sigma < 0:
            raise ValueError(f"Noised: sigma is {self.sigma}, but must not be negative")

    def __call__(self, chunk: Tensor) -> Tensor:
        return chunk + self.sigma * randn(chunk.shape, self._generators(chunk), like=chunk)


@dataclass
class Laggy(Perturbation):
    """The chunk last emitted comes again instead of the new one: delay, stalls."""

    # Probability of a repetition, p_rep. The first chunk of an episode has nothing to repeat.
    p: float = 0.2

    def __post_init__(self) -> None:
        _check_probability("Laggy", "p", self.p)

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        super().reset(batch_size, seed, first_episode)
        self._emitted: Tensor | None = None

    def __call__(self, chunk: Tensor) -> Tensor:
        repeats = self._happens(self.p, chunk)
        self._emitted = chunk.clone() if self._emitted is None else torch.where(repeats, self._emitted, chunk)
        return self._emitted.clone()


@dataclass
class Slow(Perturbation):
    """The whole chunk scaled: hesitation (or haste, for a factor above 1)."""

    # The factor.
    alpha: float = 0.5
    # Probability that a chunk is scaled, p_slow.
    p: float = 0.5

    def __post_init__(self) -> None:
        _check_finite("Slow", "alpha", self.alpha)
        _check_probability("Slow", "p", self.p)

    def __call__(self, chunk: Tensor) -> Tensor:
        return torch.where(self._happens(self.p, chunk), self.alpha * chunk, chunk)


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
        _check_finite("Shift", "alpha", self.alpha)
        _check_probability("Shift", "p", self.p)

    def __call__(self, chunk: Tensor) -> Tensor:
        if not 0 <= self.dim < chunk.shape[-1]:
            raise ValueError(f"Shift: dim is {self.dim}, but actions have dimensions 0 to {chunk.shape[-1] - 1}")
        offset = torch.zeros(chunk.shape[-1], dtype=chunk.dtype, device=chunk.device)
        offset[self.dim] = self.alpha
        return torch.where(self._happens(self.p, chunk), chunk + offset, chunk)


PERTURBATIONS: dict[str, type[Perturbation]] = {"noised": Noised, "laggy": Laggy, "slow": Slow, "shift": Shift}
