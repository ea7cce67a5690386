"""Intervals and tests on success counts, in closed form."""

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist, fmean

from lerobot_gloves.report.clusters import effective_size, sign_flip

Z_95 = NormalDist().inv_cdf(0.975)
"""Half width of a 95 % interval, in standard errors."""


def wilson(successes: float, trials: float) -> tuple[float, float]:
    """The 95 % Wilson score interval of a success rate, without continuity correction.

    Args:
        successes: How many; no whole number if it stands for clustered ones, see `effective_size`.
        trials: Of how many.

    Raises:
        ValueError: If there were no trials.
    """
    if trials <= 0:
        raise ValueError("wilson: no trials")
    rate, z2 = successes / trials, Z_95**2
    centre = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 * sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    return max(0.0, centre - half), min(1.0, centre + half)


def success_interval(outcomes: Sequence[bool], clusters: Sequence[Hashable]) -> tuple[float, float]:
    """The 95 % Wilson interval of a success rate, of as many trials as clustered episodes are worth.

    Args:
        outcomes: Whether each episode succeeded.
        clusters: What it began with; each its own where all are independent.
    """
    trials = effective_size(outcomes, clusters)
    return wilson(fmean(outcomes) * trials, trials)


@dataclass(frozen=True)
class PairedDifference:
    """How much more often one method succeeds than another in the same episodes.

    Attributes:
        mean: Difference of the success rates, in [-1, 1].
        low: Lower end of its 95 % interval, see `newcombe`.
        high: Upper end.
        p_value: Two-sided exact test of no difference, see `sign_flip`; of one comparison, corrected for no others.
        pairs: Number of episodes.
    """

    mean: float
    low: float
    high: float
    p_value: float
    pairs: int


def paired_difference(
    raw: Sequence[bool], adapted: Sequence[bool], clusters: Sequence[Hashable] | None = None
) -> PairedDifference:
    """Compare two methods by the outcomes of the same episodes, in the same order.

    Args:
        raw: Whether each episode succeeded with the first method.
        adapted: Whether it did with the second.
        clusters: What it began with; None if all are independent.

    Raises:
        ValueError: If there are no episodes, or not the same number of both.
    """
    if not raw or len(raw) != len(adapted):
        raise ValueError(f"paired_difference: {len(raw)} outcomes of one method, {len(adapted)} of the other")
    if clusters is None:
        clusters = range(len(raw))
    counts = Counter((bool(after), bool(before)) for before, after in zip(raw, adapted, strict=True))
    found = [int(after) - int(before) for before, after in zip(raw, adapted, strict=True)]
    # Where no episode differs, the differences tell nothing of clusters, and the outcomes themselves must.
    share = effective_size(found if any(found) else raw, clusters) / len(raw)
    both, gained, lost, neither = (
        counts[pair] * share for pair in [(True, True), (True, False), (False, True), (False, False)]
    )
    low, high = newcombe(both, gained, lost, neither)
    return PairedDifference(fmean(found), low, high, sign_flip(found, clusters), len(raw))


def newcombe(both: float, gained: float, lost: float, neither: float) -> tuple[float, float]:
    """The 95 % interval of a difference of paired success rates.

    Method 10 of Newcombe, "Improved confidence intervals for the difference between binomial proportions based on
    paired data" (Statistics in Medicine, 1998): the Wilson intervals of both rates, combined by their correlation. It
    stays within [-1, 1] and, unlike the normal approximation, has a width where no pair differs.

    Args:
        both: Pairs in which both methods succeeded; no whole number if it stands for clustered ones.
        gained: Pairs in which only the second did.
        lost: Pairs in which only the first did.
        neither: Pairs in which both failed.

    Returns:
        Interval of the second method's rate minus the first's.

    Raises:
        ValueError: If there are no pairs.
    """
    pairs = both + gained + lost + neither
    if pairs <= 0:
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


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number: each below 0.05 is significant with all others looked at.

    Holm, "A simple sequentially rejective multiple test procedure" (Scandinavian Journal of Statistics, 1979): the
    chance of one false finding or more stays below the level, however the comparisons depend on each other.
    """
    corrected, largest = [0.0] * len(p_values), 0.0
    for place, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - place) * p_values[index]))
        corrected[index] = largest
    return corrected
