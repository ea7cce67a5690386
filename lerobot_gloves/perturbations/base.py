"""What every perturbation has: a generator for each environment, and what an episode leaves for its next chunk."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import spawn


@dataclass
class Perturbation(ABC):
    """Something done to every chunk that an agent emits: a dataclass of numbers.

    The chunks of an episode are what the agent proposes, one after the other. What a perturbation has that goes on in
    time, such as a drift, goes on from the last action of the chunk before that was executed: by default all of it was,
    and a chunk's first action comes a step after the last one of the chunk before.

    Example:
        >>> perturbation = Noised(sigma=0.005)
        >>> perturbation.reset(batch_size=2, seed=0)
        >>> perturbation(torch.zeros(2, 10, 2)).shape
        torch.Size([2, 10, 2])
    """

    _which = 1  # Of its class, in a compound.

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        """Begin an episode in each of `batch_size` environments.

        Args:
            batch_size: Number of environments B.
            seed: The run's seed.
            first_episode: Number of the first environment's episode; the others follow it.
        """
        stream = type(self).__name__ + (f" {self._which}" if self._which > 1 else "")
        self._spawned = spawn(seed, batch_size, first_episode=first_episode, stream=stream)
        # What is left after 0, 1, ... actions of the last chunk, (B, ...) each; None at the beginning.
        self._states: list[Tensor | None] = [None]

    @abstractmethod
    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        """Perturb chunks.

        Args:
            chunk: What is proposed, (B, T, A) in raw units.
            ran: How many actions of the last chunk were executed before this one begins; None for all of them.

        Returns:
            A new tensor of that shape.
        """

    def _state(self, ran: int | None) -> Tensor | None:
        """What the actions that ran have left, None at the beginning of an episode."""
        return self._states[-1 if ran is None else min(ran, len(self._states) - 1)]

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


def check_finite(owner: str, name: str, value: float) -> None:
    """Refuse NaN and infinity."""
    if not math.isfinite(value):
        raise ValueError(f"{owner}: {name} is {value}, but must be finite")


def check_not_negative(owner: str, name: str, value: float) -> None:
    """Refuse what is negative or not finite."""
    check_finite(owner, name, value)
    if value < 0:
        raise ValueError(f"{owner}: {name} is {value}, but must not be negative")


def check_positive(owner: str, name: str, value: float) -> None:
    """Refuse what is not above zero, or not finite."""
    check_finite(owner, name, value)
    if value <= 0:
        raise ValueError(f"{owner}: {name} is {value}, but must be positive")


def check_probability(owner: str, name: str, value: float) -> None:
    """Refuse what is outside [0, 1]."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{owner}: {name} is {value}, but must lie in [0, 1]")


def check_dimension(owner: str, name: str, value: int, chunk: Tensor) -> None:
    """Refuse a dimension that the actions of a chunk (B, T, A) do not have."""
    if not 0 <= value < chunk.shape[-1]:
        raise ValueError(f"{owner}: {name} is {value}, but actions have dimensions 0 to {chunk.shape[-1] - 1}")
