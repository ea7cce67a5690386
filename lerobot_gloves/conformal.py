"""Conformal test on a nonconformity score: the gate (paper, appendix "Conformal Calibration")."""

import math

import torch
from torch import Tensor


class ConformalGate:
    """Admits a chunk unless its score is too high among the scores of held-out expert chunks.

    p(x) = (1 + #{i : s_i >= s(x)}) / (n + 1), admitted if p(x) > alpha. If the chunk is exchangeable with the
    calibration chunks, it is turned away with probability at most alpha.

    Args:
        scores: Calibration scores, shape (n,).
        alpha: Significance level, in [0, 1].

    Raises:
        ValueError: If there is no score, a score is NaN, or alpha is outside [0, 1].
    """

    def __init__(self, scores: Tensor, alpha: float = 0.05):
        scores = torch.as_tensor(scores).flatten().cpu().double()
        if scores.numel() == 0:
            raise ValueError("ConformalGate: no calibration scores")
        if scores.isnan().any():
            raise ValueError(f"ConformalGate: {int(scores.isnan().sum())} calibration scores are NaN")
        if not 0.0 <= alpha <= 1.0:
            raise ValueError(f"ConformalGate: alpha is {alpha}, but must lie in [0, 1]")
        self.scores = scores.sort().values
        self.alpha = alpha

    def p_value(self, scores: Tensor) -> Tensor:
        """Conformal p-values of scores (B,), in [1 / (n + 1), 1]: double, on the CPU, (B,)."""
        n = self.scores.numel()
        below = torch.searchsorted(self.scores, scores.cpu().double(), right=False)
        return (1 + n - below).double() / (n + 1)

    def admits(self, scores: Tensor) -> Tensor:
        """Whether each of the scores (B,) passes: bool, on their device, (B,). NaN never does."""
        return (self.p_value(scores) > self.alpha).to(scores.device) & ~scores.isnan()

    @property
    def threshold(self) -> float:
        """The largest score that is admitted, tau: infinite if all are, minus infinite if none is."""
        n = self.scores.numel()
        # The rank must agree with `admits` to the last bit, so p-values are compared, not their products.
        needed = math.floor(self.alpha * (n + 1))
        while needed > 0 and needed / (n + 1) > self.alpha:
            needed -= 1
        while (1 + needed) / (n + 1) <= self.alpha:
            needed += 1
        if needed == 0:
            return math.inf
        return -math.inf if needed > n else float(self.scores[n - needed])
