"""Intervals and tests on success counts, in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, sqrt
from statistics import NormalDist

Z_95 = NormalDist().inv_cdf(0.975)
"""Half width of a 95 % interval, in standard errors."""


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % Wilson score interval of a success rate, without continuity correction.

    Raises:
        ValueError: If there were no trials.
    """
    if trials < 1:
        raise ValueError("wilson: no trials")
    rate, z2 = successes / trials, Z_95**2
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 * sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class PairedDifference:
    """How much more often one method succeeds than another in the same episodes.

    Attributes:
        mean: Difference of the success rates, in [-1, 1].
        low: Lower end of its 95 % interval, by the normal approximation.
        high: Upper end.
        p_value: Two-sided exact McNemar test of no difference.
        pairs: Number of episodes.
    """

    mean: float
    low: float
    high: float
    p_value: float
    pairs: int


def paired_difference(raw: Sequence[bool], adapted: Sequence[bool]) -> PairedDifference:
    """Compare two methods by the outcomes of the same episodes, in the same order.

    Raises:
        ValueError: If there are no episodes, or not the same number of both.
    """
    if not raw or len(raw) != len(adapted):
        raise ValueError(f"paired_difference: {len(raw)} outcomes of one method, {len(adapted)} of the other")
    pairs = len(raw)
    gained = sum(after and not before for before, after in zip(raw, adapted, strict=True))
    lost = sum(before and not after for before, after in zip(raw, adapted, strict=True))
    mean = (gained - lost) / pairs
    half = Z_95 * sqrt((gained + lost) / pairs - mean**2) / sqrt(pairs)
    return PairedDifference(mean, max(-1.0, mean - half), min(1.0, mean + half), mcnemar(gained, lost), pairs)


def mcnemar(gained: int, lost: int) -> float:
    """Two-sided exact McNemar p-value: under no difference, a pair that differs is gained or lost with even odds.

    Args:
        gained: Pairs in which only the second method succeeded.
        lost: Pairs in which only the first did.
    """
    differing = gained + lost
    tail = sum(comb(differing, k) for k in range(min(gained, lost) + 1))
    return min(1.0, 2 * tail / 2**differing)
