import math

import pytest
from scipy.stats import binomtest

from lerobot_gloves.benchmark.statistics import mcnemar, paired_difference, wilson


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


def test_paired_difference_published() -> None:
    """Agresti, "Categorical Data Analysis", approval of a prime minister asked twice: 944 then 880 of 1600."""
    before = [True] * 794 + [True] * 150 + [False] * 86 + [False] * 570
    after = [True] * 794 + [False] * 150 + [True] * 86 + [False] * 570
    found = paired_difference(before, after)
    assert found.pairs == 1600
    assert found.mean == pytest.approx(-0.04)
    assert (found.high - found.low) / 2 == pytest.approx(1.96 * 0.0095, abs=1e-4)
    assert (found.low, found.high) == pytest.approx((-0.06, -0.02), abs=2e-3)
    assert found.p_value == pytest.approx(binomtest(86, 236).pvalue, rel=1e-9)


def test_paired_difference_is_that_of_the_normal_approximation() -> None:
    """The same as mean and standard error of the differences, computed one by one."""
    raw = [True, False, False, True, False, True, False, False, True, False]
    adapted = [True, True, True, False, True, True, True, False, True, True]
    differences = [int(after) - int(before) for before, after in zip(raw, adapted, strict=True)]
    mean = sum(differences) / 10
    deviation = math.sqrt(sum((d - mean) ** 2 for d in differences) / 10)
    found = paired_difference(raw, adapted)
    assert found.mean == pytest.approx(mean)
    assert found.high - found.mean == pytest.approx(1.959964 * deviation / math.sqrt(10), rel=1e-6)


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


@pytest.mark.parametrize(("gained", "lost"), [(0, 0), (0, 1), (5, 0), (8, 3), (40, 40), (700, 500)])
def test_mcnemar_agrees_with_scipy(gained: int, lost: int) -> None:
    expected = binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
    assert mcnemar(gained, lost) == pytest.approx(expected, rel=1e-9)
