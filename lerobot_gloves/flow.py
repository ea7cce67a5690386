"""Rectified flow: the straight path, its loss, its integration and its endpoint estimate.

Paper, section "Background", with its time convention: t = 0 is noise, t = 1 is the action.

A velocity field is any callable `velocity(x, t) -> v` with `x` and `v` of shape (N, T, A) and `t` of shape
(N,); whatever it is conditioned on is already bound. A field bound to B contexts also takes N = n * B rows, the
n rows of one context adjacent, so that n samples share one encoded context.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor

from lerobot_gloves.generators import rand, randn

type VelocityField = Callable[[Tensor, Tensor], Tensor]


def interpolate(noise: Tensor, action: Tensor, t: Tensor) -> Tensor:
    """Point of the straight path, x_t = (1 - t) x_0 + t x_1.

    Args:
        noise: x_0, shape (N, T, A).
        action: x_1, shape (N, T, A).
        t: Times in [0, 1], shape (N,).

    Returns:
        x_t, shape (N, T, A).
    """
    t = t[:, None, None]
    return (1 - t) * noise + t * action


def endpoint(x: Tensor, t: Tensor, velocity: Tensor) -> Tensor:
    """One-step estimate of the action, x_1 = x_t + (1 - t) v (paper, FEEG; the same in IFAE's Algorithm 1).

    Args:
        x: x_t, shape (N, T, A).
        t: Times in [0, 1], shape (N,).
        velocity: v(x_t, t), shape (N, T, A).

    Returns:
        Estimate of x_1, shape (N, T, A).
    """
    return x + (1 - t)[:, None, None] * velocity


def integrate(
    velocity: VelocityField,
    x: Tensor,
    start: float = 0.0,
    end: float = 1.0,
    steps: int = 10,
    grid: Sequence[float] | None = None,
) -> Tensor:
    """Integrate dx/dt = velocity(x, t) with Euler steps, forward or backward in time.

    Args:
        velocity: The velocity field.
        x: State at time `start`, shape (N, T, A).
        start: Time to begin at.
        end: Time to stop at; before `start` to run the flow in reverse.
        steps: Number of equal steps.
        grid: The times themselves, first to last, instead of `start`, `end` and `steps`.

    Returns:
        State at time `end`, shape (N, T, A).

    Raises:
        ValueError: If there is no step to take.
    """
    if grid is None:
        if steps < 1:
            raise ValueError(f"integrate: steps is {steps}, but must be at least 1")
        grid = [start + (end - start) * k / steps for k in range(steps + 1)]
    elif len(grid) < 2:
        raise ValueError(f"integrate: grid has {len(grid)} time, but must have at least 2")
    for now, then in pairwise(grid):
        x = x + (then - now) * velocity(x, times(now, x))
    return x


def times(t: float, x: Tensor) -> Tensor:
    """The same time for every row of `x` (N, ...): shape (N,), dtype and device of `x`."""
    return torch.full((x.shape[0],), t, dtype=x.dtype, device=x.device)


def flow_matching_loss(
    velocity: VelocityField,
    action: Tensor,
    *,
    mask: Tensor | None = None,
    samples: int = 1,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Conditional flow-matching loss, E ||v(x_t, t) - (x_1 - x_0)||^2, of every chunk (paper, "Flow Matching").

    Args:
        velocity: The velocity field, bound to the B contexts of `action`.
        action: Expert chunks x_1, shape (B, T, A).
        mask: True where an action counts, shape (B, T); padding is left out of the mean. None: all count.
        samples: Independent draws of noise and of time (uniform) per chunk.
        generator: Source of the draws.

    Returns:
        Mean squared error per chunk, shape (B,); 0 for a chunk that is all padding.
    """
    action = action.repeat_interleave(samples, dim=0)
    noise = randn(action.shape, generator, like=action)
    t = rand(action.shape[:1], generator, like=action)
    error = (velocity(interpolate(noise, action, t), t) - (action - noise)).square()
    return mean_per_chunk(error, samples, mask)


def mean_per_chunk(error: Tensor, samples: int, mask: Tensor | None) -> Tensor:
    """Mean (B,) of errors (B * samples, T, A), those of one chunk adjacent, over what `mask` (B, T) counts."""
    error = error.mean(-1).unflatten(0, (-1, samples)).mean(1)
    if mask is None:
        return error.mean(-1)
    weight = mask.to(error.dtype)
    return (error * weight).sum(-1) / weight.sum(-1).clamp(min=1)
