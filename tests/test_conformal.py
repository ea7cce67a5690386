"""The conformal test against brute force, scipy and its own guarantee."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from scipy import stats

from lerobot_gloves.conformal import ConformalGate, JointGate

ALPHAS = ["0", "0.01", "0.05", "0.1", "0.2", "0.25", "0.3", "0.5", "0.6", "0.7", "0.75", "0.9", "0.95", "1"]


def brute_force(calibration: list[float], score: float) -> Fraction:
    """The paper's p-value, counted one by one, exactly."""
    return Fraction(1 + sum(s >= score for s in calibration), len(calibration) + 1)


def calibrations() -> list[list[float]]:
    """Sizes around those where alpha (n + 1) is whole, and heavy ties."""
    rng = np.random.default_rng(0)
    distinct = [rng.chisquare(4, size=n).tolist() for n in (1, 2, 3, 4, 9, 18, 19, 20, 39, 99)]
    tied = [rng.integers(0, 4, size=n).astype(float).tolist() for n in (1, 5, 9, 19, 49)]
    return [*distinct, *tied, [2.0] * 19]


def probes(calibration: list[float]) -> list[float]:
    """Every calibration score, its two neighbours in floating point, and the far ends."""
    near = [math.nextafter(s, side) for s in calibration for side in (-math.inf, math.inf)]
    return [*calibration, *near, -1.0, 1e9, -math.inf, math.inf]


def double(values: list[float]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_a_p_value_by_hand():
    gate = ConformalGate(double([3.0, 1.0, 2.0, 2.0]), alpha=0.2)
    assert gate.p_value(double([0.5, 1.0, 1.5, 2.0])).tolist() == [1, 1, 0.8, 0.8]
    assert gate.p_value(double([2.5, 3.0, 3.5])).tolist() == [0.4, 0.4, 0.2]
    assert gate.admits(double([3.0, 3.5])).tolist() == [True, False]
    assert gate.threshold == 3.0


def test_p_values_equal_the_count_one_by_one():
    for calibration in calibrations():
        gate = ConformalGate(double(calibration))
        scores = probes(calibration)
        expected = [float(brute_force(calibration, score)) for score in scores]
        assert gate.p_value(double(scores)).tolist() == expected


def test_p_values_equal_scipy_percentiles():
    rng = np.random.default_rng(1)
    calibration, scores = rng.normal(size=200).round(1), rng.normal(size=50).round(1)
    below = stats.percentileofscore(calibration, scores, kind="strict") / 100
    expected = (1 + len(calibration) * (1 - below)) / (len(calibration) + 1)
    p = ConformalGate(torch.from_numpy(calibration)).p_value(torch.from_numpy(scores))
    np.testing.assert_allclose(p.numpy(), expected, rtol=1e-12)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_gate_admits_exactly_what_the_definition_says(alpha):
    """With alpha as it is written, a decimal fraction: 0.3 means 3/10, and p = 3/10 is turned away."""
    for calibration in calibrations():
        scores = probes(calibration)
        expected = [brute_force(calibration, score) > Fraction(alpha) for score in scores]
        admitted = ConformalGate(double(calibration), alpha=float(alpha)).admits(double(scores))
        assert admitted.dtype == torch.bool
        assert admitted.tolist() == expected


@pytest.mark.parametrize("alpha", ALPHAS)
def test_the_threshold_admits_exactly_what_the_gate_admits(alpha):
    for calibration in calibrations():
        gate = ConformalGate(double(calibration), alpha=float(alpha))
        scores = double(probes(calibration))
        finite = scores[scores.isfinite()]
        assert torch.equal(finite <= gate.threshold, gate.admits(finite)), (calibration, gate.threshold)


@pytest.mark.parametrize("n", [9, 19, 48, 99])
def test_the_threshold_agrees_with_the_gate_where_alpha_is_a_p_value(n):
    """At every multiple of 1 / (n + 1), where alpha * (n + 1) may round either way, and next to it."""
    scores = torch.arange(n, dtype=torch.float64)
    for k in range(1, n + 1):
        for alpha in (k / (n + 1), math.nextafter(k / (n + 1), 0), math.nextafter(k / (n + 1), 1)):
            gate = ConformalGate(scores, alpha=alpha)
            assert torch.equal(scores <= gate.threshold, gate.admits(scores)), alpha


def test_too_few_calibration_scores_to_reject_anything_admit_everything():
    """The smallest p-value is 1 / (n + 1), so alpha below it never rejects."""
    gate = ConformalGate(double([1.0] * 18), alpha=0.05)
    assert gate.threshold == math.inf
    assert gate.admits(double([1e300])).item()
    assert not ConformalGate(double([1.0] * 19), alpha=0.05).admits(double([1e300])).item()


def test_nan_is_never_admitted():
    for alpha in (0.0, 0.05, 0.5):
        assert not ConformalGate(double([1.0, 2.0]), alpha=alpha).admits(double([math.nan])).item()


def test_single_precision_scores_meet_double_precision_calibration_without_a_change_of_verdict():
    calibration = torch.rand(99, generator=torch.Generator().manual_seed(0))
    gate = ConformalGate(calibration.double(), alpha=0.05)
    assert torch.equal(gate.p_value(calibration), gate.p_value(calibration.double()))


def test_whole_numbers_as_calibration_do_not_round_the_scores():
    gate = ConformalGate(torch.tensor([1, 2, 3]))
    assert gate.p_value(double([2.5])).tolist() == [0.5]


def test_calibration_scores_may_be_numpy_or_any_order():
    scores = np.random.default_rng(2).normal(size=50)
    probe = torch.from_numpy(np.linspace(-2, 2, 20))
    one = ConformalGate(scores).p_value(probe)
    other = ConformalGate(torch.from_numpy(scores[::-1].copy())).p_value(probe)
    assert torch.equal(one, other)


def last_p_value(scores: np.ndarray) -> np.ndarray:
    """p-value of the last score of every row, calibrated on the others of its row."""
    rows = torch.from_numpy(scores)
    return np.array([ConformalGate(row[:-1]).p_value(row[-1:]).item() for row in rows])


@pytest.mark.parametrize("correlated", [False, True], ids=["independent", "only exchangeable"])
def test_p_values_are_uniform_on_exchangeable_data(correlated):
    """Each test score has a calibration set of its own: uniformity is a statement over both draws."""
    rng = np.random.default_rng(3)
    n, trials = 19, 4000
    scores = rng.chisquare(6, size=(trials, n + 1))
    if correlated:  # A scale shared by a set and its test score: not independent, but still exchangeable.
        scores *= rng.lognormal(sigma=1.0, size=(trials, 1))
    p = last_p_value(scores)
    counts = np.bincount(np.rint(p * (n + 1)).astype(int), minlength=n + 2)[1:]
    assert counts.sum() == trials
    assert stats.chisquare(counts).pvalue > 0.01
    # Spread evenly below its step, the discrete p-value is uniform on [0, 1].
    assert stats.kstest(p - rng.random(trials) / (n + 1), "uniform").pvalue > 0.01


def test_ties_make_the_test_careful_never_too_eager():
    """Rejection at level alpha happens with probability at most alpha."""
    rng = np.random.default_rng(4)
    n, trials = 19, 4000
    scores = rng.integers(0, 3, size=(trials, n + 1)).astype(float)
    p = last_p_value(scores)
    for alpha in (0.05, 0.1, 0.3, 0.5):
        slack = 3 * math.sqrt(alpha * (1 - alpha) / trials)
        assert (p <= alpha).mean() <= alpha + slack


def test_calibrated_on_itself_the_gate_rejects_a_share_of_alpha():
    scores = torch.from_numpy(np.random.default_rng(5).chisquare(2, size=999))
    assert (~ConformalGate(scores, alpha=0.05).admits(scores)).sum() == 49


@pytest.mark.parametrize(
    ("scores", "alpha", "message"),
    [
        ([], 0.05, "no calibration scores"),
        ([1.0, math.nan], 0.05, "1 calibration scores are NaN"),
        ([1.0], -0.1, r"alpha is -0\.1"),
        ([1.0], 1.5, r"alpha is 1\.5"),
        ([1.0], math.nan, "alpha is nan"),
    ],
)
def test_bad_calibration_is_refused_in_one_line(scores, alpha, message):
    with pytest.raises(ValueError, match=message) as error:
        ConformalGate(double(scores), alpha=alpha)
    assert "\n" not in str(error.value)


def test_two_scores_by_hand():
    """Of 9 scores each: alone a p-value is a tenth of the rank from above, together twice the smaller one."""
    ranks = double([*range(1, 10)])
    gate = JointGate([ranks, 10 * ranks], alpha=0.4)
    scores = torch.stack([double([5.0, 9.5, 1.0, 8.0]), double([50.0, 10.0, 95.0, 80.0])])
    assert gate.p_value(scores).tolist() == pytest.approx([1.0, 0.2, 0.2, 0.6])
    assert gate.admits(scores).tolist() == [True, False, False, True]
    assert gate.thresholds == (8.0, 80.0), "each at 0.2, where alone 0.4 would have 6"
    assert ConformalGate(ranks, alpha=0.4).threshold == 6.0


def test_one_score_together_is_one_alone():
    scores = double(np.random.default_rng(6).normal(size=50).round(1).tolist())
    probe = torch.linspace(-3, 3, 41).double()
    alone, together = ConformalGate(scores, alpha=0.1), JointGate([scores], alpha=0.1)
    assert torch.equal(together.p_value(probe[None]), alone.p_value(probe))
    assert torch.equal(together.admits(probe[None]), alone.admits(probe)) and together.thresholds == (alone.threshold,)


@pytest.mark.parametrize(("relation", "share"), [(-1.0, 0.1), (0.0, None), (1.0, 0.05)])
def test_of_exchangeable_chunks_two_scores_turn_away_at_most_alpha_however_they_hang_together(relation, share):
    """Each of 100 chunks against the other 99: exactly alpha where no chunk is bad twice, half where all are."""
    rng = np.random.default_rng(7)
    first = rng.normal(size=100)
    second = relation * first if relation else rng.normal(size=100)
    both = torch.tensor(np.stack([first, second]))
    turned_away = 0
    for i in range(100):
        others = torch.cat([both[:, :i], both[:, i + 1 :]], dim=1)
        turned_away += int(not JointGate(list(others), alpha=0.1).admits(both[:, i : i + 1]).item())
    assert turned_away <= 10
    assert share is None or turned_away == round(100 * share)


def test_a_joint_level_outside_its_range_is_refused():
    with pytest.raises(ValueError, match=r"JointGate: alpha is 1\.5, but must lie in \[0, 1\]"):
        JointGate([double([1.0]), double([1.0])], alpha=1.5)  # of which each score's part is valid
    with pytest.raises(ValueError, match="JointGate: no calibration scores"):
        JointGate([])


def test_chunks_of_one_episode_may_cost_up_to_one_episode_more_than_alpha():
    """Each of 49 episodes of 28 equal chunks against the other 48, as docs/gate.md has it."""
    episodes, turned_away = double([*map(float, range(49))]), 0
    for i in range(49):
        others = torch.cat([episodes[:i], episodes[i + 1 :]]).repeat_interleave(28)
        turned_away += int(not ConformalGate(others, alpha=0.05).admits(episodes[i : i + 1]).item())
    assert turned_away == 3, "the episode above all others has p = 1 / 1345, the next 29 / 1345, then 57 / 1345"
    assert 0.05 < turned_away / 49 <= 0.05 + 0.95 / 49
