import math

import numpy as np
import pytest
from scipy.stats import binomtest

from lerobot_gloves.report.statistics import holm, newcombe, paired_difference, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion" (1998), table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_published(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (30, 30), (150, 300), (299, 300)])
def test_wilson_agrees_with_scipy(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_wilson_needs_trials() -> None:
    with pytest.raises(ValueError, match="no trials"):
        wilson(0, 0)


def outcomes(both: int, gained: int, lost: int, neither: int) -> tuple[list[bool], list[bool]]:
    first = [True] * both + [False] * gained + [True] * lost + [False] * neither
    second = [True] * both + [True] * gained + [False] * lost + [False] * neither
    return first, second


@pytest.mark.parametrize(
    ("counts", "low", "high"),
    [
        # Newcombe, "Improved confidence intervals for the difference between binomial proportions based on paired
        # data" (1998), method 10.
        ((20, 12, 2, 16), 0.0562, 0.3292),
        ((36, 12, 2, 0), 0.0569, 0.3404),
        ((54, 0, 0, 0), -0.0664, 0.0664),
        # Fagerland, Lydersen, Laake, "Recommended tests and confidence intervals for paired binomial proportions"
        # (2014): airway hyper-responsiveness before and after a transplantation.
        ((1, 1, 7, 12), -0.507, -0.026),
    ],
)
def test_newcombe_published(counts: tuple[int, int, int, int], low: float, high: float) -> None:
    places = 3 if counts == (1, 1, 7, 12) else 4
    assert newcombe(*counts) == pytest.approx((low, high), abs=0.501 * 10**-places)
    found = paired_difference(*outcomes(*counts))
    assert (found.low, found.high) == newcombe(*counts)
    assert found.mean == pytest.approx((counts[1] - counts[2]) / sum(counts))


@pytest.mark.parametrize("successes", [0, 1, 150, 299, 300])
def test_equal_outcomes_still_leave_doubt(successes: int) -> None:
    """With no pair of 300 that differs, at least the 3 / n of the rule of three must stay possible, or nearly so."""
    outcome = [True] * successes + [False] * (300 - successes)
    found = paired_difference(outcome, outcome)
    assert (found.mean, found.p_value) == (0.0, 1.0)
    assert found.high == -found.low
    assert 0.006 < found.high < 0.02


def test_the_interval_covers_the_difference() -> None:
    """Exactly, over all tables of 25 pairs: at least 93 % at each of several truths, where Wald's has less."""
    pairs, worst_wald = 25, 1.0
    tables = [
        (a, b, c, pairs - a - b - c)
        for a in range(pairs + 1)
        for b in range(pairs + 1 - a)
        for c in range(pairs + 1 - a - b)
    ]
    ways = [math.factorial(pairs) / math.prod(math.factorial(count) for count in table) for table in tables]
    intervals = [newcombe(*table) for table in tables]
    for truth in [(0.9, 0.04, 0.01, 0.05), (0.3, 0.2, 0.1, 0.4), (0.6, 0.02, 0.02, 0.36), (0.1, 0.5, 0.1, 0.3)]:
        covered = wald = 0.0
        difference = truth[1] - truth[2]
        for table, count, (low, high) in zip(tables, ways, intervals, strict=True):
            probability = count * math.prod(p**k for p, k in zip(truth, table, strict=True))
            mean = (table[1] - table[2]) / pairs
            half = 1.96 * math.sqrt((table[1] + table[2]) / pairs - mean**2) / math.sqrt(pairs)
            covered += probability * (low <= difference <= high)
            wald += probability * (mean - half <= difference <= mean + half)
        assert 0.93 < covered < 1
        worst_wald = min(worst_wald, wald)
    assert worst_wald < 0.8


def test_large_samples_agree_with_the_normal_approximation() -> None:
    """Agresti, "Categorical Data Analysis", approval of a prime minister asked twice: 944 then 880 of 1600."""
    found = paired_difference(*outcomes(794, 86, 150, 570))
    assert found.pairs == 1600
    assert found.mean == pytest.approx(-0.04)
    assert (found.high - found.low) / 2 == pytest.approx(1.96 * 0.0095, abs=2e-4)
    assert found.p_value == pytest.approx(binomtest(86, 236).pvalue, rel=1e-9)


def test_paired_difference_is_antisymmetric() -> None:
    one, other = [True, False, False, False, True], [False, True, True, False, True]
    there, back = paired_difference(one, other), paired_difference(other, one)
    assert (there.mean, there.low, there.high) == pytest.approx((-back.mean, -back.high, -back.low))
    assert there.p_value == back.p_value


def test_paired_difference_needs_pairs() -> None:
    with pytest.raises(ValueError, match="2 outcomes of one method, 1 of the other"):
        paired_difference([True, False], [True])
    with pytest.raises(ValueError, match="0 outcomes"):
        paired_difference([], [])
    with pytest.raises(ValueError, match="no pairs"):
        newcombe(0, 0, 0, 0)


def test_holm_by_hand() -> None:
    """0.005 x 4, 0.01 x 3, 0.03 x 2, and 0.04 x 1, which must not be below the one before."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.6]) == [1.0, 1.0]
    assert holm([]) == []


def test_holm_keeps_the_chance_of_any_false_finding_below_the_level() -> None:
    """Of 20 comparisons without a difference, one or more is below 0.05 in about 5 % of the tables, not in 64 %."""
    rng = np.random.default_rng(0)
    tables = rng.random((4000, 20)).tolist()
    assert np.mean([min(table) < 0.05 for table in tables]) > 0.6
    assert 0.035 < np.mean([min(holm(table)) < 0.05 for table in tables]) < 0.06
