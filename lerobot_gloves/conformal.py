"""Conformal test on nonconformity scores: the gate (paper, appendix "Conformal Calibration")."""

import math
from collections.abc import Sequence

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


class JointGate:
    """Admits a chunk if each of m scores does, every one of them at level alpha / m.

    Not in the paper. By the union bound a chunk that is exchangeable with the calibration chunks is turned away with
    probability at most alpha, however the scores hang together (Bonferroni).

    Args:
        scores: Calibration scores of each of the m scores, of shape (n,).
        alpha: Significance level, in [0, 1].

    Attributes:
        gates: The gate of each score.

    Raises:
        ValueError: If there are no scores, `ConformalGate` refuses some, or alpha is outside [0, 1].
    """

    def __init__(self, scores: Sequence[Tensor], alpha: float = 0.05):
        if not scores:
            raise ValueError("JointGate: no calibration scores")
        if not 0.0 <= alpha <= 1.0:
            raise ValueError(f"JointGate: alpha is {alpha}, but must lie in [0, 1]")
        self.gates = [ConformalGate(one, alpha / len(scores)) for one in scores]

    def p_value(self, scores: Tensor) -> Tensor:
        """M times the smallest p-value, at most 1, of scores (m, B): double, on the CPU, (B,)."""
        found = torch.stack([gate.p_value(one) for gate, one in zip(self.gates, scores, strict=True)])
        return (len(self.gates) * found.amin(dim=0)).clamp(max=1.0)

    def admits(self, scores: Tensor) -> Tensor:
        """Whether each of B chunks passes by its scores (m, B): bool, on their device, (B,)."""
        return torch.stack([gate.admits(one) for gate, one in zip(self.gates, scores, strict=True)]).all(dim=0)

    @property
    def thresholds(self) -> tuple[float, ...]:
        """The threshold of each score."""
        return tuple(gate.threshold for gate in self.gates)


def auroc(clean: Tensor, worse: Tensor) -> float:
    """Probability that a worse chunk scores above a clean one, ties counted half; NaN counts for nothing."""
    ordered, worse = clean[~clean.isnan()].sort().values, worse[~worse.isnan()]
    below, most = (torch.searchsorted(ordered, worse, right=right).double() for right in (False, True))
    return ((below + most) / 2).mean().item() / len(ordered)
