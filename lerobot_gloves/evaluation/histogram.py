"""Histograms of scores that stay small in a row's file: chunks by the number of their bin, empty bins left out.

Bins are the same for every row, so that histograms of episodes, seeds and cells add up. Their edges are those of an
inverse hyperbolic sine: even around 0, and a constant factor apart from there on, for scores of either sign.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from math import asinh, floor, isnan, sinh

SCALE = 0.1
"""Scores much smaller than this share the bins beside 0."""
BINS_PER_E = 5
"""Bins while a large score grows by the factor e: each is 22 % wider than the last."""
LARGEST = 1e15
"""Scores beyond it, infinite ones among them, share its bin."""

type Histogram = dict[str, int]
"""Chunks by the number of their bin; a string, because it is a key of JSON."""


def add(histogram: Histogram, score: float) -> None:
    """Count one more score, unless it is NaN."""
    if not isnan(score):
        number = str(floor(BINS_PER_E * asinh(min(max(score, -LARGEST), LARGEST) / SCALE)))
        histogram[number] = histogram.get(number, 0) + 1


def edge(number: int) -> float:
    """The least score of a bin; that of the next one is where it ends."""
    return SCALE * sinh(number / BINS_PER_E)


def total(histograms: Iterable[Mapping[str, int]]) -> dict[int, int]:
    """The sum of histograms, by the number of the bin, lowest first."""
    counts: Counter[int] = Counter()
    for histogram in histograms:
        counts.update({int(number): count for number, count in histogram.items()})
    return dict(sorted(counts.items()))
