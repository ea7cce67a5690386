"""Random draws that do not depend on the batch they were made in: one generator per environment."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

type Generators = torch.Generator | Sequence[torch.Generator] | None
"""One generator for a whole batch, one for each of its rows, or None for torch's global one."""


def randn(shape: Sequence[int], generator: Generators, *, like: Tensor) -> Tensor:
    """Standard normal noise of a shape (N, ...), drawn as `_draw` says."""
    return _draw(torch.randn, shape, generator, like)


def rand(shape: Sequence[int], generator: Generators, *, like: Tensor) -> Tensor:
    """Noise uniform on [0, 1) of a shape (N, ...), drawn as `_draw` says."""
    return _draw(torch.rand, shape, generator, like)


def _draw(draw: Callable[..., Tensor], shape: Sequence[int], generator: Generators, like: Tensor) -> Tensor:
    """Draw on the generators' device, then move to the device of `like`, whose dtype the result has.

    A sequence of B generators shares out the N rows: each draws N / B adjacent ones, which makes a row's noise
    independent of the rows beside it.

    Raises:
        ValueError: If the number of generators does not divide the number of rows.
    """
    if generator is None or isinstance(generator, torch.Generator):
        device = like.device if generator is None else generator.device
        return draw(tuple(shape), generator=generator, dtype=like.dtype, device=device).to(like.device)
    if len(generator) == 0 or shape[0] % len(generator):
        raise ValueError(f"{shape[0]} rows cannot be shared out among {len(generator)} generators")
    rows = (shape[0] // len(generator), *shape[1:])
    drawn = [draw(rows, generator=one, dtype=like.dtype, device=one.device) for one in generator]
    return torch.cat(drawn).to(like.device)


def spawn(seed: int, batch_size: int, *, first_episode: int = 0, stream: str = "") -> list[torch.Generator]:
    """One generator per environment, each a function of the seed, its episode's number and the stream alone.

    Args:
        seed: The run's seed, at least 0.
        batch_size: Number of environments B.
        first_episode: Number of the episode that the first environment runs; the others follow it.
        stream: Name of what is drawn, so that two purposes never share their draws.

    Returns:
        B generators on the CPU. On the CPU so that a GPU run draws the same noise.
    """
    purpose = list(stream.encode())
    generators = []
    for episode in range(first_episode, first_episode + batch_size):
        entropy = np.random.SeedSequence([seed, episode, *purpose])
        state = int(entropy.generate_state(1, np.uint64)[0] >> np.uint64(1))
        generators.append(torch.Generator().manual_seed(state))
    return generators


class Episodes:
    """Counts the episodes that a policy begins, since LeRobot's `reset()` says neither how many nor which.

    Attributes:
        first: Number of the first environment's episode since the last `begin`.
        batch_size: Environments that run side by side since the last `begin`.
    """

    def __init__(self) -> None:
        self.first = self.batch_size = 0
        self._next = 0
        self._running = False

    def reset(self) -> None:
        """The episodes that ran, if any, are over."""
        self._running = False

    def begin(self, batch_size: int) -> bool:
        """Note that `batch_size` environments are running; True if these are new episodes."""
        if self._running and self.batch_size == batch_size:
            return False
        self._running, self.first, self.batch_size = True, self._next, batch_size
        self._next += batch_size
        return True
