"""A score of a chunk's leading actions, where it is the one of shorter chunks that was calibrated."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from lerobot_gloves.adapter import pad
from lerobot_gloves.flow import VelocityField
from lerobot_gloves.scores.score import Score, ask, needs_posterior


@dataclass(frozen=True)
class Leading:
    """What a score says of the first actions of a chunk, the last of them repeated in the place of the others.

    Attributes:
        score: The score.
        length: How many actions count.
    """

    score: Score
    length: int

    @property
    def needs_posterior(self) -> bool:
        """Whether the score does."""
        return needs_posterior(self.score)

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None, **told: Any) -> Tensor:
        """Scores (N,) of chunks (N, T, A), whatever `length` counts besides; see `lerobot_gloves.scores.Score`."""
        return ask(self.score, velocity, pad(chunk[:, : self.length], chunk.shape[1]), self.length, **told)
