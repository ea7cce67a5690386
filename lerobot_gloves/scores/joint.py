"""Several scores as one, for an editor that knows of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField
from lerobot_gloves.scores.score import Score, ask, needs_posterior


@dataclass(frozen=True)
class Joint:
    """How far a chunk lies above the worst of several thresholds: above 0 where one score turns it away.

    Attributes:
        scores: The scores.
        thresholds: The largest value of each that is admitted.
    """

    scores: tuple[Score, ...]
    thresholds: tuple[float, ...]

    @property
    def needs_posterior(self) -> bool:
        """Whether one of them does."""
        return any(map(needs_posterior, self.scores))

    @property
    def starts_at_chunk(self) -> bool:
        """Whether one of them does."""
        return any(getattr(score, "starts_at_chunk", False) for score in self.scores)

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None, **told: Any) -> Tensor:
        """Excesses (N,) of chunks (N, T, A); see `lerobot_gloves.scores.Score`."""
        found = [ask(score, velocity, chunk, length, **told) for score in self.scores]
        return excess(torch.stack(found), self.thresholds)


def excess(scores: Tensor, thresholds: Sequence[float]) -> Tensor:
    """How far m scores of each of N chunks, (m, N), lie above their thresholds at most: (N,)."""
    bounds = torch.as_tensor(thresholds, dtype=torch.float64, device=scores.device)[:, None]
    # An infinite score is admitted by an infinite threshold, and their difference is not a number.
    over = torch.where(scores == bounds, 0.0, scores.double() - bounds)
    return over.amax(dim=0).to(scores.dtype)
