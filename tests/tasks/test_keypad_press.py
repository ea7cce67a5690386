"""Keypad's episodes of one press, which demonstrations are made of."""

from collections import Counter

import numpy as np
import pytest

from lerobot_gloves.recording import dataset, demonstrations, staging
from lerobot_gloves.tasks.keypad import KeypadEnv, scene
from lerobot_gloves.tasks.keypad.environment import Keypad
from tests.tasks.stylus import BUTTONS, OVER, above, go, press


@pytest.fixture(scope="module")
def env():
    return Keypad(episode="press")


@pytest.fixture(scope="module")
def starts(env):
    """First observations of the episodes with the seeds 0 to 449."""
    return [(env.reset(seed=seed)[0], env.task) for seed in range(450)]


def at_home(observation):
    return observation["agent_pos"][5] == pytest.approx(0.09)


def split(observation):
    travels, lights = np.split(observation["environment_state"], 2)
    return travels, np.flatnonzero(lights).tolist()


def test_every_button_is_asked_for_equally_often(starts):
    assert set(Counter(task for _, task in starts).items()) == {(str(button), 50) for button in range(9)}
    for observation, task in starts:
        assert np.flatnonzero(observation["goal"]).tolist() == [int(task)]


def test_one_press_in_ten_begins_at_home_in_the_dark(starts):
    home = [observation for observation, _ in starts if at_home(observation)]
    assert 25 <= len(home) <= 68  # 45 of 450, give or take 3.5 standard deviations
    for observation in home:
        travels, lights = split(observation)
        assert not travels.any() and lights == []
        assert observation["agent_pos"][:3] == pytest.approx([0.5, 0.0, 0.09], abs=0.001)


def test_the_others_begin_on_any_button_just_pressed(starts):
    previous, same, further, floors = Counter(), 0, 0, 0
    pressed = [start for start in starts if not at_home(start[0])]
    for observation, task in pressed:
        travels, lights = split(observation)
        button = int(travels.argmax())
        assert travels[button] > 0.005 and np.delete(travels, button).max() == 0
        assert button in lights and len(lights) <= 2
        offset = observation["agent_pos"][:2] - BUTTONS[button]
        assert np.abs(offset).max() < 0.0145  # the frame is at 0.016
        assert 0.03 <= observation["agent_pos"][5] + 1e-7 < 0.038
        floors += observation["agent_pos"][5] < 0.0301
        previous[button] += 1
        same += button == int(task)
        further += len(lights) == 2
    expected = len(pressed) / 9
    assert all(abs(previous[button] - expected) < 3.5 * expected**0.5 for button in range(9))
    assert abs(same - expected) < 3.5 * expected**0.5
    assert 0.34 < further / len(pressed) < 0.55  # half of the cases, and then one time in nine the same button
    assert 0.5 < floors / len(pressed) < 0.95  # some pushed on to the end, some stopped at once


def test_a_press_that_begins_on_its_own_button_needs_a_release(env, starts):
    seeds = [seed for seed, (start, task) in enumerate(starts) if split(start)[0][int(task)] > 0]
    for seed in seeds[:3]:
        observation, info = env.reset(seed=seed)
        assert info == OVER
        button = int(env.task)
        x, y, _ = observation["agent_pos"][3:6]
        observations, outcome = go(env, observation, (x, y, 0.03), (x, y, 0.037), (x, y, 0.03))
        assert outcome[-1] == OVER
        _, outcome = go(env, observations[-1], (x, y, 0.05), above(button), above(button, 0.03))
        assert outcome == (1.0, True, False, {"is_success": True, "failure": ""})


def test_a_press_ends_with_its_button_and_fails_with_another(env):
    for mode, failure in (("3", ""), ("4", "wrong_button")):
        observation, _ = env.reset(seed=1, options={"mode": mode})
        assert env.task == mode
        x, y, _ = observation["agent_pos"][3:6]
        _, outcome = go(env, observation, (x, y, 0.07), *press(3))
        assert outcome[-1] == {"is_success": not failure, "failure": failure}


def test_all_of_it_follows_from_the_seed_alone(env):
    other = Keypad(episode="press", obs_type="pixels_agent_pos", image_size=32)
    for seed in (7, 30005, 8):
        first, _ = env.reset(seed=seed)
        env.step(np.full(3, -0.01))
        second, _ = other.reset(seed=seed)
        other.step(np.full(3, 0.01))
        assert np.array_equal(first["agent_pos"], second["agent_pos"]) and env.task == other.task
    first, _ = env.reset(seed=1)
    second, _ = env.reset(seed=10)  # the same button
    assert not np.array_equal(first["agent_pos"], second["agent_pos"])


def test_recorded_presses_are_labelled_with_their_button(tmp_path):
    config = KeypadEnv()
    folder = tmp_path / "staging"
    folder.mkdir()
    for _ in demonstrations.record(config, folder, num_episodes=4, seed=30000, num_workers=1):
        pass
    env = Keypad(episode="press")
    for index in range(4):
        episode = staging.load(folder, index)
        button = (30000 + index) % 9
        assert episode.task == str(button) and config.modes.index(episode.task) == button
        assert (episode.frames["mode"] == button).all()
        assert (episode.frames["observation.goal"].argmax(axis=1) == button).all()
        first, _ = env.reset(seed=30000 + index)
        assert np.array_equal(episode.frames["observation.state"][0], first["agent_pos"])
        assert np.array_equal(episode.frames["observation.environment_state"][0], first["environment_state"])
        assert np.abs(episode.frames["action"]).max() <= np.float32(0.01)
        assert {key: values.shape[1:] for key, values in episode.frames.items()} == {
            key: feature["shape"]
            for key, feature in dataset.dataset_features(config, next(episode.rows()), video=False).items()
        }


def test_demonstrations_are_presses_and_everything_else_is_codes():
    config = KeypadEnv()
    assert config.gym_kwargs["episode"] == "code" and config.demonstration_kwargs["episode"] == "press"
    assert config.demonstrations == 450
    assert config.modes[:9] == tuple("012345678") and config.modes[9:] == scene.CODES
