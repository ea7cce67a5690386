"""Slalom's scripted expert."""

import numpy as np
import pytest

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.tasks.slalom import scene
from lerobot_gloves.tasks.slalom.environment import Slalom
from lerobot_gloves.tasks.slalom.expert import SlalomExpert


@pytest.fixture(scope="module")
def env():
    return Slalom()


def demonstrate(env, seed, rng, disturb=lambda step, action: action):
    expert = SlalomExpert(rng)
    observation, info = env.reset(seed=seed)
    expert.reset(env.task_description)
    actions = []
    over = False
    while not over:
        actions.append(expert.act(observation))
        observation, _, terminated, truncated, info = env.step(disturb(len(actions), actions[-1]))
        over = terminated or truncated
    return np.array(actions), info


def test_the_expert_passes_every_corridor_never_twice_alike(env):
    lengths, actions = [], []
    for seed in range(24):
        played, info = demonstrate(env, seed, np.random.default_rng(seed))
        assert info == {"is_success": True, "failure": ""}, env.task_description
        lengths.append(len(played))
        actions.append(played)
    assert min(lengths) > 80 and max(lengths) < 250
    assert all(np.abs(played).max() <= np.float32(0.01) for played in actions)
    again, _ = demonstrate(env, 0, np.random.default_rng(0))
    other, _ = demonstrate(env, 0, np.random.default_rng(1000))
    assert np.array_equal(again, actions[0])
    assert np.abs(other[:80] - again[:80]).max() > 0.001


def test_the_expert_steers_back_when_it_is_carried_off(env):
    for seed in range(0, 24, 5):
        for sign in (-1, 1):
            # For the first ten steps it goes sideways whatever the expert wants: 4 cm.
            disturb = lambda step, action, sign=sign: np.array([sign * 0.004, 0.002]) if step < 11 else action  # noqa: E731
            _, info = demonstrate(env, seed, np.random.default_rng(seed), disturb)
            assert info["is_success"], (env.task_description, info["failure"])


def test_a_jostled_expert_wants_to_go_back(env):
    """What is executed is pushed about; what the expert asked for opposes where the pushes have carried it."""
    within = []
    for seed in range(6):
        expert = SlalomExpert(np.random.default_rng(seed))
        observation, _ = env.reset(seed=seed)
        expert.reset(env.task_description)
        at, wanted, executed, over = [], [], [], False
        while not over:
            action = expert.act(observation)
            at.append(observation["agent_pos"][:2].astype(float))
            wanted.append(action)
            executed.append(expert.disturb(action))
            observation, _, terminated, truncated, _ = env.step(executed[-1])
            over = terminated or truncated
        assert np.abs(np.subtract(wanted, executed)).max() > 0.001
        # Past the last row's gap the way leads straight ahead: any wish to go sideways is a correction.
        last = np.array(at)[:, 1] > 0.24
        within.append(np.corrcoef(np.array(at)[last, 0], np.array(wanted)[last, 0])[0, 1])
    assert np.mean(within) < -0.5


def test_the_expert_may_change_its_mind_in_the_aisle(env):
    """Some demonstrations of a corridor first set out for another gap; all of them end in the right one."""
    ways = []
    for draw in range(12):
        expert = SlalomExpert(np.random.default_rng(draw))
        observation, _ = env.reset(seed=0)
        expert.reset("1 0 0")  # from the start, x = 0.525, to the gap at 0.575
        way = []
        while observation["agent_pos"][1] < -0.1:
            way.append(observation["agent_pos"][0])
            observation, *_ = env.step(expert.act(observation))
        assert scene.gap_of(0, observation["agent_pos"][0]) == 1
        ways.append(min(way))
    assert min(ways) < 0.5 and sorted(ways)[6] > 0.515


@pytest.mark.slow
def test_the_expert_hardly_ever_fails(env):
    succeeded = [
        demonstrate(env, 60000 + i, np.random.default_rng([1, i]))[1]["is_success"] for i in range(120)
    ]  # each corridor five times
    assert all(succeeded)
