"""The haste, drift and jitter that the scripted experts share."""

import numpy as np
import pytest

from lerobot_gloves.tasks.jostling import JostledExpert


class Straight(JostledExpert):
    """Goes ahead at speed 1."""

    action_bound = 10.0
    jostled = 2
    haste_noise = 0.02
    drift_noise = 0.1
    jitter_range = (0.3, 0.5)

    def _begin(self, mode):
        self.first_draw = self._rng.random()

    def act(self, observation):
        return self._clipped(np.array([self._hurry(), 0.0]))


def begun(seed):
    expert = Straight(np.random.default_rng(seed))
    expert.reset("any")
    return expert


def pushes(expert, steps):
    return np.array([expert.disturb(np.zeros(2)) for _ in range(steps)], dtype=np.float64)


def test_drift_and_haste_are_the_sums_of_all_past_noise_ever_less_of_the_older():
    for seed in range(4):
        expert, rng = begun(seed), np.random.default_rng(seed)
        assert expert.first_draw == rng.random()  # an episode's own draws come first
        jitter = rng.choice([0.0, 1.0]) * rng.uniform(0.3, 0.5)
        noise = rng.standard_normal((60, 2, 2))  # a step: drift, then jitter
        ages = np.arange(60)[:, None] - np.arange(60)
        kept = np.where(ages >= 0, (29 / 30) ** np.maximum(ages, 0), 0.0)
        expected = 0.1 * kept @ noise[:, 0] + jitter * noise[:, 1]
        assert pushes(expert, 60) == pytest.approx(expected, abs=1e-6)

        kept = np.where(ages >= 0, (24 / 25) ** np.maximum(ages, 0), 0.0)
        haste = np.array([expert.act({})[0] for _ in range(60)], dtype=np.float64)
        assert np.log(haste) == pytest.approx(0.02 * kept @ rng.standard_normal(60), abs=1e-6)


def test_in_the_long_run_they_spread_as_an_autoregressive_process_does():
    smooth = next(expert for expert in map(begun, range(20)) if expert._jitter == 0)
    drift = pushes(smooth, 40_000)[200:]
    assert drift.mean(axis=0) == pytest.approx([0, 0], abs=0.06)
    # Tolerances are nearly four standard errors.
    assert drift.std(axis=0) == pytest.approx(0.1 / np.sqrt(1 - (29 / 30) ** 2), rel=0.07)
    assert np.corrcoef(drift[:-1, 0], drift[1:, 0])[0, 1] == pytest.approx(29 / 30, abs=0.006)
    assert abs(np.corrcoef(drift.T)[0, 1]) < 0.12  # each entry has its own
    haste = np.log([smooth.act({})[0] for _ in range(40_000)])[200:]
    assert haste.std() == pytest.approx(0.02 / np.sqrt(1 - (24 / 25) ** 2), rel=0.07)


def test_half_of_the_episodes_jitter_each_as_strongly_throughout():
    rough = []
    for seed in range(400):
        steps = pushes(begun(seed), 100)
        # A step's change holds two draws of jitter; what drift adds to it is 0.1 wide.
        rough.append(np.diff(steps, axis=0).std() / np.sqrt(2))
    strong = np.array(rough) > 0.2
    assert 160 < strong.sum() < 240  # four standard deviations of a fair coin
    assert (np.array(rough)[~strong] < 0.1).all()
    assert np.quantile(np.array(rough)[strong], [0.1, 0.5, 0.9]) == pytest.approx([0.325, 0.405, 0.485], abs=0.03)


def test_what_reaches_the_robot_is_an_action_and_what_was_wanted_stays_as_it_is():
    expert, wanted = begun(0), np.array([9.9, -9.9], dtype=np.float32)
    disturbed = np.array([expert.disturb(wanted) for _ in range(200)])
    assert disturbed.dtype == np.float32 and np.abs(disturbed).max() == 10
    assert (wanted == np.array([9.9, -9.9], dtype=np.float32)).all()


def test_a_new_episode_begins_without_haste_and_drift():
    expert = begun(0)
    pushes(expert, 500)
    expert._rng = np.random.default_rng(5)
    expert.reset("any")
    assert np.array_equal(pushes(expert, 20), pushes(begun(5), 20))
