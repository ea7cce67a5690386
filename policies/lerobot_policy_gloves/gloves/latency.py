"""Quantiles of a long run's latencies, in bounded memory."""

from collections import Counter
from math import ceil, exp, log

_BINS_PER_E = 100
_SHORTEST, _LONGEST = 1e-3, 1e6


class Latencies:
    """A histogram whose bins are 1 % wide, from a microsecond to a quarter of an hour: at most some 2000 numbers."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def note(self, milliseconds: float) -> None:
        """Count one more."""
        self._counts[round(_BINS_PER_E * log(min(max(milliseconds, _SHORTEST), _LONGEST)))] += 1

    def quantile(self, share: float) -> float:
        """The latency, in milliseconds, that this share of all, in (0, 1], does not exceed, to 1 %; 0 of none."""
        wanted = ceil(share * self._counts.total())
        for number in sorted(self._counts):
            wanted -= self._counts[number]
            if wanted <= 0:
                return exp(number / _BINS_PER_E)
        return 0.0
