"""Nonconformity scores: how unlike the expert a chunk of actions is. One score, one file."""

from collections.abc import Callable

from torch import Tensor

from lerobot_gloves.scores.likelihood import LikelihoodScore
from lerobot_gloves.scores.residual import ResidualScore
from lerobot_gloves.scores.reverse import ReverseScore
from lerobot_gloves.scores.self_normalised import SelfNormalisedScore

type Score = Callable[..., Tensor]
"""`score(velocity, chunk, length=None) -> (N,)`; a larger score is less like the expert."""

SCORES: dict[str, type] = {
    "reverse": ReverseScore,
    "residual": ResidualScore,
    "likelihood": LikelihoodScore,
    "selfnormalised": SelfNormalisedScore,
}
"""Scores by the name that `--policy.score` gives, the default first."""

__all__ = ["SCORES", "LikelihoodScore", "ResidualScore", "ReverseScore", "Score", "SelfNormalisedScore"]
