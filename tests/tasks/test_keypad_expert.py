"""Keypad's scripted expert."""

import numpy as np
import pytest

from lerobot_gloves.tasks.keypad.environment import Keypad
from lerobot_gloves.tasks.keypad.expert import KeypadExpert
from tests.tasks.stylus import BUTTONS, above, go

SUCCESS = {"is_success": True, "failure": ""}


def as_wanted(step, action):
    return action


def demonstrate(env, seed, rng, disturb=as_wanted, observation=None):
    """Observations, actions and the last info; from the reset, or from an observation on."""
    expert = KeypadExpert(rng)
    if observation is None:
        observation, _ = env.reset(seed=seed)
    expert.reset(env.task_description)
    observations, actions = [observation], []
    over = False
    while not over:
        actions.append(expert.act(observation))
        observation, _, terminated, truncated, info = env.step(disturb(len(actions), actions[-1]))
        observations.append(observation)
        over = terminated or truncated
    return observations, np.array(actions), info


def jostled(env, seed, rng):
    """The same while the robot is jostled, as it is recorded."""
    expert = KeypadExpert(rng)
    observation, _ = env.reset(seed=seed)
    expert.reset(env.task_description)
    wanted, executed, over = [], [], False
    while not over:
        wanted.append(expert.act(observation))
        executed.append(expert.disturb(wanted[-1]))
        observation, _, terminated, truncated, info = env.step(executed[-1])
        over = terminated or truncated
    return np.array(wanted), np.array(executed), info


def heights(observations):
    return np.array([observation["agent_pos"][2] for observation in observations])


def test_the_expert_enters_codes_and_presses_buttons_never_twice_alike():
    for episode, shortest, longest in (("code", 60, 400), ("press", 5, 140)):
        env = Keypad(episode=episode)
        _, actions, info = demonstrate(env, 0, np.random.default_rng(0))
        for seed in range(1, 10):
            _, played, info = demonstrate(env, seed, np.random.default_rng(seed))
            assert info == SUCCESS, env.task
            assert shortest < len(played) < longest and np.abs(played).max() <= np.float32(0.01)
        _, again, _ = demonstrate(env, 0, np.random.default_rng(0))
        _, other, _ = demonstrate(env, 0, np.random.default_rng(1))
        assert np.array_equal(again, actions)
        n = min(len(other), len(actions))
        assert np.abs(other[:n] - actions[:n]).max() > 0.001


@pytest.mark.parametrize("code", ["4 4 4", "0 0 8", "3 7 7"])
def test_the_expert_presses_one_button_again_and_again(code):
    env = Keypad(mode=code)
    assert demonstrate(env, 0, np.random.default_rng(0))[-1] == SUCCESS


def test_the_expert_leaves_a_button_upward_before_it_travels():
    env = Keypad(mode="0 8 0")
    for draw in range(5):
        observations, _, info = demonstrate(env, 0, np.random.default_rng(draw))
        assert info == SUCCESS
        for observation in observations:
            x, y, z = observation["agent_pos"][:3]
            if z < 0.05:  # no more than 4 mm above the frame: only over a button's well
                assert np.abs(np.subtract((x, y), BUTTONS)).max(axis=1).min() < 0.012


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_expert_finds_its_way_when_it_is_carried_off(axis, sign):
    env = Keypad()
    away = np.zeros(3)
    away[axis] = sign * 0.004
    for seed in range(3):
        # From the first step on it goes sideways for 4 cm, whatever the expert wants.
        disturb = lambda step, action: away if step <= 10 else action  # noqa: E731
        assert demonstrate(env, seed, np.random.default_rng(seed), disturb)[-1] == SUCCESS


@pytest.mark.parametrize("wrong", [0, 5, 7])
def test_the_expert_gets_out_of_a_wrong_well(wrong):
    """Low above a button that is not due, and beside its centre."""
    env = Keypad(mode="4 8 2")
    observation, _ = env.reset(seed=0)
    (*_, observation), _ = go(env, observation, above(wrong), above(wrong, 0.042, dx=0.01, dy=-0.01))
    observations, actions, info = demonstrate(env, 0, np.random.default_rng(0), observation=observation)
    assert info == SUCCESS
    assert actions[0][2] > 0.002 and actions[0][0] < 0 < actions[0][1]  # up, and away from the frame
    assert heights(observations)[:20].max() > 0.06


@pytest.mark.parametrize("axis", [0, 1])
def test_what_a_pushed_expert_wants_is_to_go_back(axis):
    """Pushed by 1 mm a step it goes down beside its aim, and on the way wants to go the other way."""
    env = Keypad(episode="press", mode="4")
    wishes = {}
    for sign in (-1, 1):
        push = sign * 0.001 * np.eye(3, dtype=np.float32)[axis]
        _, actions, info = demonstrate(env, 5, np.random.default_rng(3), lambda _, action, push=push: action + push)
        assert info == SUCCESS
        wishes[sign] = actions[-12:, axis].mean()
    assert wishes[1] < -0.0005 < 0.0005 < wishes[-1]


def test_the_robot_is_jostled_and_jitters_in_half_of_the_episodes():
    jitter = []
    for draw in range(60):
        expert = KeypadExpert(np.random.default_rng(draw))
        expert.reset("4")
        pushes = np.array([expert.disturb(np.zeros(3)) for _ in range(200)])
        assert 0.0001 < np.abs(pushes.mean(axis=0) + pushes.std(axis=0)).max() < 0.002
        jitter.append(np.diff(pushes, axis=0).std() / 2**0.5)
    smooth = np.array(jitter) < 0.00012
    assert 15 <= smooth.sum() <= 45
    assert np.all((np.array(jitter)[~smooth] > 0.00017) & (np.array(jitter)[~smooth] < 0.0009))


def test_the_expert_may_first_set_out_for_another_button():
    """Some presses leave the straight way from home to their button far; all of them end on it."""
    env = Keypad(episode="press", mode="0")
    seed = next(seed for seed in range(100) if env.reset(seed=seed)[0]["agent_pos"][5] > 0.08)  # begins at home
    farthest = []
    for draw in range(40):
        observations, _, info = demonstrate(env, seed, np.random.default_rng(draw))
        assert info == SUCCESS
        way = np.array([observation["agent_pos"][:2] for observation in observations]) - (0.5, 0.0)
        along = np.clip(-way.sum(axis=1), 0.0, 0.1) / 2  # button 0 is at (-0.05, -0.05) from there
        farthest.append(np.linalg.norm(way + along[:, None], axis=1).max())
    assert max(farthest) > 0.03 and sorted(farthest)[25] < 0.012


@pytest.mark.slow
@pytest.mark.parametrize("episode", ["code", "press"])
@pytest.mark.parametrize("play", [demonstrate, jostled])
def test_the_expert_hardly_ever_fails(episode, play):
    env = Keypad(episode=episode)
    succeeded = [play(env, 60000 + i, np.random.default_rng([1, i]))[-1]["is_success"] for i in range(100)]
    assert np.mean(succeeded) >= 0.98
