"""Episodes that begin alike are no independent ones: how many they are worth, and a test that moves them together."""

from collections import defaultdict
from collections.abc import Hashable, Sequence
from statistics import fmean

import numpy as np


def totals(values: Sequence[float], clusters: Sequence[Hashable]) -> list[float]:
    """Sum of the values of each cluster, in the order of their first ones.

    A single cluster says nothing of others: its values are taken for independent, each a cluster of its own.

    Args:
        values: One an episode.
        clusters: What each episode belongs to.

    Raises:
        ValueError: If there are none, or not as many of both.
    """
    if not values or len(values) != len(clusters):
        raise ValueError(f"clusters: {len(values)} values, {len(clusters)} clusters")
    sums: dict[Hashable, float] = defaultdict(float)
    for value, cluster in zip(values, clusters, strict=True):
        sums[cluster] += value
    return list(sums.values()) if len(sums) > 1 else list(values)


def variance(residuals: Sequence[float], clusters: Sequence[Hashable]) -> float:
    """Cluster-robust variance of an estimate.

    That of the ratio estimator, by linearisation: clusters may differ in size, and what happens inside one is free.

    Args:
        residuals: What each episode adds to the estimate, less what it adds on average: their sum is 0.
        clusters: What each episode belongs to.
    """
    sums = totals(residuals, clusters)
    return len(sums) / max(len(sums) - 1, 1) * sum(one**2 for one in sums)


def effective_size(values: Sequence[float], clusters: Sequence[Hashable]) -> float:
    """How many independent episodes would tell as much of the values' mean as these do.

    Rao and Scott, "A simple method for the analysis of clustered binary data" (Biometrics, 1992): counts divided by
    their design effect, the mean's cluster-robust variance over that of independent values, at least 1, go where counts
    of independent episodes would. Franco, Little, Louis and Slud, "Comparative study of confidence intervals for
    proportions in complex sample surveys" (Journal of Survey Statistics and Methodology, 2019), find Wilson's interval
    among the best that take them. Both variances are the unbiased ones, so that values that are alike inside every
    cluster are worth exactly as many as there are clusters. Values that are alike everywhere may be so for that
    reason, and are worth no more.

    Args:
        values: One an episode, such as its success, or its difference between two methods.
        clusters: What each episode belongs to.

    Returns:
        At most the number of episodes.
    """
    size, groups = len(values), len(totals(values, clusters))
    if groups == size:
        return float(size)
    mean = fmean(values)
    spread = fmean((value - mean) ** 2 for value in values)
    if not spread:
        return float(groups)
    between = variance([(value - mean) / size for value in values], clusters)
    return min(float(size), spread / between + 1) if between else float(size)


def sign_flip(differences: Sequence[int], clusters: Sequence[Hashable]) -> float:
    """Two-sided exact p-value of no difference between two methods in the same episodes.

    If the methods do not differ, a cluster's sum of differences had as well the other sign (Fisher's randomisation
    test, with clusters as what is randomised): the p-value is the share of all choices of signs whose total is at least
    as far from 0 as the one that was found. Where every episode is a cluster of its own this is the exact McNemar test.

    Args:
        differences: One an episode: 1 if only the second method succeeded, -1 if only the first did, else 0.
        clusters: What each episode belongs to.
    """
    sums = [abs(round(one)) for one in totals(differences, clusters)]
    shares: np.ndarray = np.ones(1)  # of the choices of signs, by total, from the lowest to the highest, in steps of 2
    for one in filter(None, sums):
        shares = np.convolve(shares, [0.5, *[0.0] * (one - 1), 0.5])
    found = abs(sum(differences))
    ends = (sum(sums) - found) // 2 + 1  # how many totals are as low as that, and as many as high
    return float(min(1.0, 2 * shares[:ends].sum()))
