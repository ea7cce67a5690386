"""Nonconformity scores: how unlike the expert a chunk of actions is. One score, one file."""

from collections.abc import Callable

from torch import Tensor

from lerobot_gloves.scores.reverse import ReverseScore

type Score = Callable[..., Tensor]
"""`score(velocity, chunk, length=None) -> (N,)`; a larger score is less like the expert."""

SCORES: dict[str, type] = {"reverse": ReverseScore}

__all__ = ["SCORES", "ReverseScore", "Score"]
