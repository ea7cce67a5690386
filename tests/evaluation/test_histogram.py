import json
import math

import pytest

from lerobot_gloves.evaluation.histogram import add, edge, total


@pytest.mark.parametrize("score", [0.0, 1e-9, 0.03, 0.1, 1.0, 19.7, 123456.0, -0.02, -7.5, -4e8])
def test_a_score_lies_in_its_bin(score: float) -> None:
    histogram: dict[str, int] = {}
    add(histogram, score)
    ((number, count),) = histogram.items()
    assert count == 1
    assert edge(int(number)) <= score < edge(int(number) + 1)


def test_bins_of_large_scores_are_a_fifth_wide() -> None:
    for number in (20, 40, -60):
        assert edge(number + 1) / edge(number) == pytest.approx(math.exp(math.copysign(0.2, number)), rel=1e-3)
    assert edge(0) == 0.0 and edge(1) == pytest.approx(0.1 * math.sinh(0.2))


def test_scores_that_are_no_numbers() -> None:
    histogram: dict[str, int] = {}
    for score in (math.inf, 1e300, -math.inf, math.nan):
        add(histogram, score)
    assert sorted(histogram.values()) == [1, 2], "NaN is nowhere, and everything huge is together"


def test_histograms_add_up_after_a_trip_through_a_file() -> None:
    one: dict[str, int] = {}
    other: dict[str, int] = {}
    for score in (0.5, 25.0, 25.1):
        add(one, score)
    for score in (25.2, -3.0):
        add(other, score)
    summed = total([json.loads(json.dumps(one)), json.loads(json.dumps(other)), {}])
    assert list(summed) == sorted(summed), "by number, not by text"
    assert list(summed.values()) == [1, 1, 3]
    assert sum(count for number, count in summed.items() if edge(number) > 20) == 3
