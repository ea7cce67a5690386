"""Clustered episodes: exact where clusters are all alike or all apart, and right on average in between."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest, permutation_test

from lerobot_gloves.report.clusters import effective_size, sign_flip, variance
from lerobot_gloves.report.statistics import paired_difference, success_interval, wilson

CLUSTERS = [cluster for cluster in range(24) for _ in range(12)]


def repeated(values: list[bool]) -> list[bool]:
    """Every episode of a cluster of twelve has its cluster's value."""
    return [value for value in values for _ in range(12)]


@pytest.mark.parametrize("successes", [0, 1, 12, 23, 24])
def test_outcomes_alike_in_every_cluster_are_worth_as_many_as_there_are_clusters(successes: int) -> None:
    alike = [True] * successes + [False] * (24 - successes)
    assert effective_size(repeated(alike), CLUSTERS) == pytest.approx(24, rel=1e-12)
    assert success_interval(repeated(alike), CLUSTERS) == pytest.approx(wilson(successes, 24), abs=1e-12)
    other = alike[3:] + alike[:3]
    found, expected = paired_difference(repeated(alike), repeated(other), CLUSTERS), paired_difference(alike, other)
    assert (found.mean, found.low, found.high) == pytest.approx((expected.mean, expected.low, expected.high), abs=1e-12)
    assert found.p_value == pytest.approx(expected.p_value) and found.pairs == 288


def test_independent_outcomes_are_worth_all_of_themselves() -> None:
    rng = np.random.default_rng(0)
    for rate in (0.2, 0.5, 0.9):
        sizes = [effective_size((rng.random(288) < rate).tolist(), CLUSTERS) for _ in range(200)]
        assert 250 < np.mean(sizes) <= 288, "of 288; no more than that, so the mean lies below"
    evenly = [True, False] * 144
    assert effective_size(evenly, CLUSTERS) == 288, "fewer differences between clusters than by chance"


def test_without_clusters_nothing_changes() -> None:
    outcomes = [True, False, True, True, False, True, True]
    assert success_interval(outcomes, "abcdefg") == wilson(5, 7)
    assert success_interval(outcomes, "aaaaaaa") == wilson(5, 7), "one cluster alone says nothing of others"


def test_where_no_pair_differs_the_outcomes_say_what_they_are_worth() -> None:
    outcomes = [cluster < 12 or episode < 3 for cluster in range(24) for episode in range(12)]
    found = paired_difference(outcomes, outcomes, CLUSTERS)
    size = effective_size(outcomes, CLUSTERS)
    assert 24 < size < 60
    fewer = paired_difference([True] * 15 + [False] * 9, [True] * 15 + [False] * 9)
    assert (found.mean, found.p_value) == (0.0, 1.0) and 0 < found.high < fewer.high


def test_the_variance_is_the_jackknifes_over_clusters() -> None:
    """Delete-one-cluster jackknife of the mean: the same where clusters are of one size."""
    values = np.random.default_rng(1).random(288) + np.repeat(np.random.default_rng(2).random(24), 12)
    residuals = (values - values.mean()) / values.size
    left_out = [np.delete(values.reshape(24, 12), cluster, axis=0).mean() for cluster in range(24)]
    expected = 23 / 24 * np.sum((left_out - np.mean(left_out)) ** 2)
    assert variance(residuals.tolist(), CLUSTERS) == pytest.approx(expected, rel=1e-9)


def test_values_and_clusters_must_be_as_many() -> None:
    with pytest.raises(ValueError, match="2 values, 1 clusters"):
        effective_size([1, 0], ["a"])
    with pytest.raises(ValueError, match="0 values"):
        sign_flip([], [])


@pytest.mark.parametrize(("gained", "lost"), [(0, 0), (0, 1), (5, 0), (8, 3), (40, 40), (700, 500)])
def test_the_test_is_mcnemars_where_every_episode_is_its_own_cluster(gained: int, lost: int) -> None:
    differences = [1] * gained + [-1] * lost + [0] * 10
    expected = binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
    assert sign_flip(differences, range(len(differences))) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_test_is_the_share_of_all_choices_of_signs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    differences, clusters = rng.integers(-1, 2, 60).tolist(), rng.integers(0, 9, 60).tolist()
    sums = np.bincount(clusters, weights=differences)
    choices = [abs(np.dot(signs, sums)) >= abs(sums.sum()) for signs in product([-1, 1], repeat=len(sums))]
    assert sign_flip(differences, clusters) == pytest.approx(np.mean(choices), rel=1e-12)
    scipys = permutation_test((sums,), np.sum, permutation_type="samples", n_resamples=np.inf)
    assert sign_flip(differences, clusters) == pytest.approx(scipys.pvalue, rel=1e-9)


def test_intervals_and_tests_keep_their_promise_with_clusters() -> None:
    """On clusters like Slalom's: intervals cover and the test errs about as often as they say; plain ones fail."""
    rng, rate, runs = np.random.default_rng(3), 0.7, 250
    covered, plain, paired, errs, naive = [], [], [], [], []
    for _ in range(runs):
        one, two = (
            rng.random((24, 12)) < rng.beta(1.4, 0.6, (24, 1)) for _ in range(2)
        )  # intra-cluster correlation 1/3
        first, second = one.ravel().tolist(), two.ravel().tolist()
        low, high = success_interval(first, CLUSTERS)
        covered.append(low <= rate <= high)
        low, high = wilson(sum(first), 288)
        plain.append(low <= rate <= high)
        found = paired_difference(first, second, CLUSTERS)
        paired.append(found.low <= 0 <= found.high)
        errs.append(found.p_value < 0.05)
        naive.append(paired_difference(first, second).p_value < 0.05)
    assert 0.92 < np.mean(covered) < 0.98 and np.mean(plain) < 0.75
    assert 0.92 < np.mean(paired) < 0.98
    assert np.mean(errs) < 0.08 and np.mean(naive) > 0.25
