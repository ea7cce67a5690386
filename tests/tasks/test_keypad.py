import itertools

import numpy as np
import pytest
from lerobot.envs import make_env, preprocess_observation
from lerobot.envs.utils import env_to_policy_features

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.tasks.keypad import KeypadEnv, scene
from lerobot_gloves.tasks.keypad.environment import Keypad
from tests.tasks.stylus import ABOVE, BUTTONS, DEEP, OVER, above, go, moves, play, press

FAILED = (0.0, True, False)


@pytest.fixture(scope="module")
def env():
    return Keypad()


def goals(observations):
    return [int(observation["goal"].argmax()) for observation in observations]


def travels(observations):
    return np.array([observation["environment_state"][:9] for observation in observations])


def lit(observation):
    return np.flatnonzero(observation["environment_state"][9:]).tolist()


def test_buttons_are_numbered_row_by_row():
    assert np.allclose(scene.BUTTONS, BUTTONS)
    assert len(set(scene.CODES)) == 729 and scene.CODES[:2] == ("0 0 0", "0 0 1") and scene.CODES[-1] == "8 8 8"


def test_a_code_entered_in_order_succeeds_and_the_goal_moves_on_at_each_press(env):
    observations, outcome = play(env, *press(4), *press(0), *press(8), options={"mode": "4 0 8"})
    assert outcome == (1.0, True, False, {"is_success": True, "failure": ""})
    seen = goals(observations[:-1])
    first, second = seen.index(0), seen.index(8)
    assert seen == [4] * first + [0] * (second - first) + [8] * (len(seen) - second)
    # A button is due until the step in which it has travelled 5 mm, and lit from then on.
    travelled = travels(observations)
    for button, step in ((4, first), (0, second), (8, len(seen))):
        assert travelled[step - 1, button] < 0.005 < travelled[step, button]
    assert [lit(observations[step]) for step in (first - 1, first, second, -1)] == [[], [4], [0, 4], [0, 4, 8]]
    assert all(observation["goal"].sum() == 1 for observation in observations[:-1])


@pytest.mark.parametrize(
    ("lowest", "counts"),
    # A button's top is at 40 mm: with the tip at 37 its travel is 3 mm, and it can fire again only below 2.
    [(0.037, False), (0.0405, True)],
)
def test_a_button_can_fire_again_only_when_it_is_back(env, lowest, counts):
    points = [above(4), above(4, DEEP), above(4, lowest), above(4, DEEP), above(4)]
    observations, outcome = play(env, *points, options={"mode": "4 4 1"})
    assert outcome[-1] == OVER
    assert goals(observations)[-1] == (1 if counts else 4)
    assert travels(observations)[:, 4].max() > 0.0075  # it did go all the way down
    _, outcome = go(env, observations[-1], *press(1))
    assert outcome[-1] == {"is_success": counts, "failure": "" if counts else "wrong_button"}


@pytest.mark.parametrize("entered", [0, 1, 2])
def test_another_button_than_the_one_due_ends_the_episode(env, entered):
    points = [point for button in (4, 0, 8)[:entered] for point in press(button)]
    observations, outcome = play(env, *points, *press(5), options={"mode": "4 0 8"})
    assert outcome == (*FAILED, {"is_success": False, "failure": "wrong_button"})
    assert len(lit(observations[-1])) == entered


def test_presses_are_noticed_in_the_middle_of_a_step(env):
    """At 10 mm a step a button goes from rest to its stop within one: the end of the step would be too late."""
    deepest = {}
    for mode, failure in (("4 4 5", ""), ("5 5 5", "wrong_button")):
        observations, outcome = play(env, above(4, 0.041), above(4, DEEP), step=0.01, options={"mode": mode})
        assert outcome[-1]["failure"] == failure
        assert travels(observations)[-2, 4] == 0
        deepest[failure] = travels(observations)[-1, 4]
    assert deepest[""] > 0.0075
    assert 0.005 < deepest["wrong_button"] < 0.006  # the episode ended on the spot, within 2 ms


@pytest.mark.parametrize(
    ("points", "height"),
    [
        # Upon a bar between two buttons, upon a crossing, and out of a well against its side.
        ([(0.5, 0.025, ABOVE), (0.5, 0.025, 0.03)], 0.046),
        ([(0.475, 0.025, ABOVE), (0.475, 0.025, 0.03)], 0.046),
        ([above(4), above(4, 0.042), above(4, 0.042, dx=0.03)], 0.042),
        ([above(0), above(0, 0.042), above(0, 0.042, dy=-0.03)], 0.042),
    ],
)
def test_touching_the_frame_ends_the_episode_where_geometry_says(env, points, height):
    observations, outcome = play(env, *points, options={"mode": "4 0 8"})
    assert outcome == (*FAILED, {"is_success": False, "failure": "collision"})
    tip = observations[-1]["agent_pos"][:3]
    assert tip[2] == pytest.approx(height, abs=0.001)
    if height < 0.046:  # the bar's side is 21 mm from the button's centre, the stylus 5 mm thick
        assert np.abs(tip[:2] - BUTTONS[4 if points[0] == above(4) else 0]).max() == pytest.approx(0.016, abs=0.001)


def test_the_frame_is_as_wide_as_it_looks(env):
    """1.5 mm off a bar nothing happens."""
    _, outcome = play(env, *press(4, dx=0.0), *press(0, dx=-0.013, dy=0.013), options={"mode": "4 0 8"})
    assert outcome == (0.0, False, False, OVER)


def test_time_runs_out_after_1000_steps(env):
    env.reset(seed=0)
    for step in range(1, 1001):
        _, reward, terminated, truncated, info = env.step(np.array([0.0, 0.0, 0.001 * (-1) ** step]))
        if truncated:
            break
    assert (step, reward, terminated) == (1000, 0.0, False)
    assert info == {"is_success": False, "failure": "timeout"}


def test_actions_move_the_set_point_by_metres_within_limits(env):
    observation, _ = env.reset(seed=0)
    assert observation["agent_pos"][3:6] == pytest.approx([0.5, 0.0, 0.09])
    for action, expected in (((0.004, -0.002, 0.001), (0.504, -0.002, 0.091)), ((1, -1, 1), (0.514, -0.012, 0.101))):
        observation, *_ = env.step(np.array(action))
        assert observation["agent_pos"][3:6] == pytest.approx(expected)
    for _ in range(30):
        observation, *_ = env.step(np.array([0.01, -0.01, 0.01]))
    assert observation["agent_pos"][3:6] == pytest.approx([0.62, -0.12, 0.15])
    observations, _ = play(env, above(4), above(4, 0.0), options={"mode": "4 0 8"})
    assert observations[-1]["agent_pos"][5] == pytest.approx(0.03)  # the floor of the workspace
    assert travels(observations)[-1, 4] == pytest.approx(0.008, abs=0.0005)  # the button's stop


def test_the_arm_follows_its_set_point_with_the_stylus_pointing_down(env):
    for point in ((0.43, -0.07, 0.08), (0.57, 0.07, 0.06), (0.57, -0.07, 0.1)):
        observations, _ = play(env, point, point, seed=0)
        states = np.array([observation["agent_pos"] for observation in observations])
        assert np.abs(states[:, :3] - states[:, 3:6]).max() < 0.004
        tip = env._data.site("panda/tip")
        assert tip.xmat.reshape(3, 3)[:, 2] == pytest.approx([0, 0, -1], abs=0.01)


def test_the_velocity_is_how_fast_the_tip_moves(env):
    for point in ((0.43, -0.07, 0.08), above(4, 0.035)):
        observations, _ = play(env, point, options={"mode": "4 0 8"})
        tip = env._data.site("panda/tip")
        before = tip.xpos.copy()
        env._mujoco.mj_step(env._model, env._data)  # 2 ms
        velocity = observations[-1]["agent_pos"][6:]
        assert velocity == pytest.approx((tip.xpos - before) / 0.002, abs=0.005)
        assert np.linalg.norm(velocity) > 0.02
    for _ in range(10):
        observation, *_ = env.step(np.zeros(3))
    assert observation["agent_pos"][6:] == pytest.approx([0, 0, 0], abs=0.002)


def test_seeds_visit_all_codes_and_neighbouring_seeds_very_different_ones(env):
    codes = []
    for seed in range(10000, 10729):
        codes.append(scene.code_of(seed))
    assert sorted(codes) == list(scene.CODES)
    for first in (10000, 10100, 10900, 20000):
        thirty = [scene.code_of(seed).split() for seed in range(first, first + 30)]
        assert all(len({code[place] for code in thirty}) == 9 for place in range(3))
        assert all(
            max([code[place] for code in thirty].count(digit) for digit in "012345678") <= 5 for place in range(3)
        )
    for seed in (10000, 10001):
        observation, _ = env.reset(seed=seed)
        assert env.task_description == env.task == scene.code_of(seed)
        assert goals([observation]) == [int(env.task[0])] and lit(observation) == []


def test_without_a_seed_codes_are_drawn_and_a_fixed_one_stays():
    env = Keypad()
    env.reset(seed=5)
    drawn = [env.reset() and env.task_description for _ in range(10)]
    env.reset(seed=5)
    assert drawn == [env.reset() and env.task_description for _ in range(10)]
    assert len(set(drawn)) > 5
    fixed = Keypad(mode="1 0 2")
    fixed.reset(seed=3)
    assert fixed.task == "1 0 2"
    fixed.reset(seed=3, options={"mode": "0 0 0"})
    assert fixed.task == "0 0 0"


@pytest.mark.parametrize("episode", ["code", "press"])
def test_same_actions_give_the_same_numbers_bit_for_bit(episode):
    mode = {"code": "4 0 8", "press": "4"}[episode]
    first, second = Keypad(episode=episode), Keypad(episode=episode, obs_type="pixels_agent_pos", image_size=32)
    points = [*press(4), *press(0), above(8, 0.041)][: None if episode == "code" else 2]
    expected, outcome = play(first, *points, seed=7, options={"mode": mode})
    play(first, above(5), above(5, 0.033), seed=3)  # left in the middle of a press
    for env in (first, second):  # after other episodes, and whether or not frames are drawn
        again, outcome_again = play(env, *points, seed=7, options={"mode": mode})
        assert outcome_again == outcome
        for before, after in zip(expected, again, strict=True):
            assert np.array_equal(before["agent_pos"], after["agent_pos"])
            assert np.array_equal(before["goal"], after["goal"])


@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
def test_lerobot_makes_vector_environments(obs_type):
    config = KeypadEnv(obs_type=obs_type, image_size=32, mode="4 0 8")
    env = make_env(config, n_envs=2)["gloves_keypad"][0]
    try:
        observation, _ = env.reset(seed=[20000, 20001])
        assert env.call("_max_episode_steps") == (1000, 1000)
        assert env.call("task_description") == ("4 0 8", "4 0 8")
        seen = preprocess_observation(observation)
        assert {key: tuple(value.shape[1:]) for key, value in seen.items()} == {
            key: feature.shape for key, feature in env_to_policy_features(config).items() if key != "action"
        }
        images = {key.removeprefix("observation.images.") for key in seen if "images" in key}
        assert images == (set() if obs_type == "state" else {"third_person", "wrist"})
        ways = ([*press(4), *press(0), *press(8)], [*press(4), *press(3)])
        actions_of = (moves((0.5, 0.0, 0.09), *way) for way in ways)
        for actions in itertools.zip_longest(*actions_of, fillvalue=np.zeros(3)):
            *_, info = env.step(np.array(actions, dtype=np.float32))
            if "final_info" in info and info["_final_info"][1] and not info["_final_info"][0]:
                assert info["final_info"]["failure"][1] == "wrong_button"
            if "final_info" in info and info["_final_info"][0]:
                break
        assert info["final_info"]["is_success"][0]
    finally:
        env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episode": "digit"}, "no episode 'digit': choose one of code, press"),
        ({"mode": "4 0 8", "episode": "press"}, "no press '4 0 8': give one button as in '4', from 0 to 8"),
    ],
)
@pytest.mark.parametrize("cls", [Keypad, KeypadEnv])
def test_unknown_episodes_and_their_modes_are_refused(cls, options, message):
    with pytest.raises(ValueError, match=message):
        cls(**options)


def test_a_mode_of_another_episode_is_refused_at_reset(env):
    with pytest.raises(ValueError, match="no code '4'"):
        env.reset(options={"mode": "4"})
