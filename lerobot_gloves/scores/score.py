"""What a score is, and how one is asked."""

from collections.abc import Callable
from typing import Any

from torch import Tensor

type Score = Callable[..., Tensor]
"""`score(velocity, chunk, length=None) -> (N,)`; a larger score is less like the expert.

One whose class says `needs_posterior = True` is also told of `posterior`, the expert flow given what is proposed, and
of `repeated`, which chunks are the last proposal again. One that says `starts_at_chunk = True` evaluates the expert
flow at the chunk and t = 1 first, so that an editor can share that evaluation.
"""


def needs_posterior(score: Any) -> bool:
    """Whether a score is to be told what was proposed."""
    return getattr(score, "needs_posterior", False)


def ask(score: Score, velocity: Any, chunk: Tensor, length: int | None = None, **told: Any) -> Tensor:
    """Scores (N,) of chunks (N, T, A) by any score; only one that needs the posterior is told of it."""
    return score(velocity, chunk, length=length, **(told if needs_posterior(score) else {}))
