"""Intervals and tests on success counts, in closed form."""

from collections import Counter
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
        low: Lower end of its 95 % interval, see `newcombe`.
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
    counts = Counter((bool(after), bool(before)) for before, after in zip(raw, adapted, strict=True))
    both, gained, lost, neither = (
        counts[pair] for pair in [(True, True), (True, False), (False, True), (False, False)]
    )
    low, high = newcombe(both, gained, lost, neither)
    return PairedDifference((gained - lost) / len(raw), low, high, mcnemar(gained, lost), len(raw))


def newcombe(both: int, gained: int, lost: int, neither: int) -> tuple[float, float]:
    """The 95 % interval of a difference of paired success rates.

    Method 10 of Newcombe, "Improved confidence intervals for the difference between binomial proportions based on
    paired data" (Statistics in Medicine, 1998): the Wilson intervals of both rates, combined by their correlation. It
    stays within [-1, 1] and, unlike the normal approximation, has a width where no pair differs.

    Args:
        both: Pairs in which both methods succeeded.
        gained: Pairs in which only the second did.
        lost: Pairs in which only the first did.
        neither: Pairs in which both failed.

    Returns:
        Interval of the second method's rate minus the first's.

    Raises:
        ValueError: If there are no pairs.
    """
    pairs = both + gained + lost + neither
    if pairs < 1:
        raise ValueError("newcombe: no pairs")
    second, first = (both + gained) / pairs, (both + lost) / pairs
    (second_low, second_high), (first_low, first_high) = wilson(both + gained, pairs), wilson(both + lost, pairs)
    covariance: float = both * neither - gained * lost
    if covariance > 0:
        covariance = max(0.0, covariance - pairs / 2)  # the paper's correction for continuity, towards independence
    variances = (both + gained) * (lost + neither) * (both + lost) * (gained + neither)
    correlation = covariance / sqrt(variances) if variances else 0.0

    def combined(one: float, other: float) -> float:
        return sqrt(max(0.0, one**2 - 2 * correlation * one * other + other**2))

    mean = second - first
    low = mean - combined(second - second_low, first_high - first)
    high = mean + combined(second_high - second, first - first_low)
    return max(-1.0, low), min(1.0, high)


def mcnemar(gained: int, lost: int) -> float:
    """Two-sided exact McNemar p-value: under no difference, a pair that differs is gained or lost with even odds.

    Args:
        gained: Pairs in which only the second method succeeded.
        lost: Pairs in which only the first did.
    """
    differing = gained + lost
    tail = sum(comb(differing, k) for k in range(min(gained, lost) + 1))
    return min(1.0, 2 * tail / 2**differing)
