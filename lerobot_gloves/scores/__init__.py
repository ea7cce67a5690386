"""Nonconformity scores: how unlike the expert a chunk of actions is. One score, one file."""

from lerobot_gloves.scores.correction import CorrectionScore
from lerobot_gloves.scores.joint import Joint
from lerobot_gloves.scores.leading import Leading
from lerobot_gloves.scores.likelihood import LikelihoodScore
from lerobot_gloves.scores.residual import ResidualScore
from lerobot_gloves.scores.reverse import ReverseScore
from lerobot_gloves.scores.score import Score
from lerobot_gloves.scores.self_normalised import SelfNormalisedScore

SCORES: dict[str, type] = {
    "reverse": ReverseScore,
    "residual": ResidualScore,
    "likelihood": LikelihoodScore,
    "selfnormalised": SelfNormalisedScore,
}
"""Scores by the name that `--policy.score` gives, the default first. `CorrectionScore` is one of adapters that read
proposals alone."""

__all__ = [
    "SCORES",
    "CorrectionScore",
    "Joint",
    "Leading",
    "LikelihoodScore",
    "ResidualScore",
    "ReverseScore",
    "Score",
    "SelfNormalisedScore",
]
