import importlib
import sys

import numpy as np
import pytest
from lerobot.envs import make_env, preprocess_observation
from lerobot.envs.configs import PushtEnv
from lerobot.envs.utils import env_to_policy_features

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.recording.experts import check_expert
from lerobot_gloves.tasks import panda
from lerobot_gloves.tasks.slalom import SlalomEnv, scene
from lerobot_gloves.tasks.slalom.environment import Slalom

RIGHT_OF_FIRST_PILLAR = [(0.01, 0.0)] * 6  # to x = 0.585
TO_MIDDLE = [(0.0, 0.01)] * 26 + [(-0.01, 0.0)] * 8  # past the first row, then to x = 0.505
TO_THIRD_ROW = [(0.0, 0.01)] * 19 + [(-0.01, 0.0)] * 8  # past the second row, then to x = 0.425
TO_GOAL = [(0.0, 0.01)] * 20
CORRIDOR_111 = RIGHT_OF_FIRST_PILLAR + TO_MIDDLE + TO_THIRD_ROW + TO_GOAL


def play(env, actions, **reset):
    """Play until the actions or the episode end; the observations with the first, and the last step's outcome."""
    observation, info = env.reset(**reset)
    assert info == {"is_success": False, "failure": ""}
    observations = [observation]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(np.array(action))
        observations.append(observation)
        if terminated or truncated:
            break
        assert (reward, info) == (0.0, {"is_success": False, "failure": ""})
    return observations, (reward, terminated, truncated, info)


@pytest.fixture(scope="module")
def env():
    return Slalom()


def test_corridors_are_counted_from_small_x():
    assert len(set(scene.MODES)) == 24 and scene.MODES[0] == "0 0 0" and scene.MODES[-1] == "1 2 3"
    assert [scene.gap_of(0, x) for x in (0.45, 0.55)] == [0, 1]
    assert [scene.gap_of(1, x) for x in (0.3, 0.5, 0.6)] == [0, 1, 2]
    assert [scene.gap_of(2, x) for x in (0.3, 0.4, 0.6, 0.7)] == [0, 1, 2, 3]


def test_the_requested_corridor_succeeds(env):
    observations, outcome = play(env, CORRIDOR_111, options={"mode": "1 1 1"})
    assert outcome == (1.0, True, False, {"is_success": True, "failure": ""})
    assert observations[-1]["agent_pos"][3] > 0.35 >= observations[-2]["agent_pos"][3]


@pytest.mark.parametrize(("mode", "row_y"), [("0 1 1", -0.10), ("1 0 1", 0.08), ("1 2 1", 0.08), ("1 1 2", 0.26)])
def test_another_gap_than_requested_ends_the_episode_at_its_row(env, mode, row_y):
    observations, outcome = play(env, CORRIDOR_111, options={"mode": mode})
    assert outcome == (0.0, True, False, {"is_success": False, "failure": "wrong_corridor"})
    assert observations[-2]["agent_pos"][3] < row_y <= observations[-1]["agent_pos"][3]


def test_touching_a_pillar_ends_the_episode_where_geometry_says(env):
    observations, outcome = play(env, [(0.0, 0.01)] * 40, options={"mode": "1 1 1"})
    assert outcome == (0.0, True, False, {"is_success": False, "failure": "collision"})
    # Rod (radius 0.01) and pillar (0.03) meet when their axes are 0.04 apart; the rod goes 0.025 beside the axis.
    touch_y = -0.10 - np.sqrt(0.04**2 - 0.025**2)
    assert observations[-2]["agent_pos"][3] < touch_y + 1e-3
    assert observations[-1]["agent_pos"][3] == pytest.approx(touch_y, abs=0.012)  # at most one step further


def test_time_runs_out_after_300_steps(env):
    observations, outcome = play(env, np.zeros((400, 2)), seed=0)
    assert len(observations) == 301
    assert outcome == (0.0, False, True, {"is_success": False, "failure": "timeout"})


def test_actions_move_the_set_point_by_metres_within_limits(env):
    observations, _ = play(env, [(0.004, -0.002), (1.0, -1.0)], seed=0)
    assert observations[0]["agent_pos"][:2] == pytest.approx([0.525, -0.28])
    assert observations[1]["agent_pos"][:2] == pytest.approx([0.529, -0.282])
    assert observations[2]["agent_pos"][:2] == pytest.approx([0.539, -0.292])
    observations, _ = play(env, [(0.01, -0.01)] * 60, seed=0)
    assert observations[-1]["agent_pos"][:2] == pytest.approx([0.8, -0.35])


def test_the_arm_follows_its_set_point_and_the_rod_hangs_down(env):
    for action in ([0.0, -0.01], [0.01, 0.0], [-0.01, 0.0]):
        observations, _ = play(env, [action] * 7 + [(0.0, 0.0)] * 10, seed=0)
        moving, resting = observations[7]["agent_pos"], observations[-1]["agent_pos"]
        assert np.abs(moving[2:] - moving[:2]).max() < 0.006
        assert np.abs(resting[2:] - resting[:2]).max() < 0.0005
        tip = env._data.site("panda/tip")
        assert tip.xpos[2] == pytest.approx(0.03, abs=0.001)
        assert tip.xmat.reshape(3, 3)[:, 2] == pytest.approx([0, 0, -1], abs=0.01)


def test_consecutive_seeds_visit_all_corridors(env):
    modes = []
    for seed in range(30000, 30048):
        observation, _ = env.reset(seed=seed)
        modes.append(env.task_description)
        gaps = [int(gap) for gap in modes[-1].split()]
        assert np.flatnonzero(observation["goal"]).tolist() == [gaps[0], 2 + gaps[1], 5 + gaps[2]]
    assert sorted(modes[:24]) == sorted(modes[24:]) == sorted(scene.MODES)


def test_without_a_seed_corridors_are_drawn_and_a_fixed_one_stays():
    env = Slalom()
    env.reset(seed=5)
    drawn = [env.reset() and env.task_description for _ in range(20)]
    env.reset(seed=5)
    assert drawn == [env.reset() and env.task_description for _ in range(20)]
    assert len(set(drawn)) > 5
    fixed = Slalom(mode="1 0 2")
    fixed.reset(seed=3)
    assert fixed.task == fixed.task_description == "1 0 2"
    fixed.reset(seed=3, options={"mode": "0 0 0"})
    assert fixed.task_description == "0 0 0"


def test_same_actions_give_the_same_numbers_bit_for_bit():
    actions = np.random.default_rng(0).uniform([-0.008, -0.0095], [0.012, 0.0105], (150, 2))
    first, second = Slalom(), Slalom(obs_type="pixels_agent_pos", image_size=64)
    expected, outcome = play(first, actions, seed=7)
    play(first, actions[:50], seed=3)
    for env in (first, second):  # after other episodes, and whether or not frames are drawn
        again, outcome_again = play(env, actions, seed=7)
        assert outcome_again == outcome
        for before, after in zip(expected, again, strict=True):
            assert np.array_equal(before["agent_pos"], after["agent_pos"])


def test_frames_never_show_the_requested_corridor():
    env = Slalom(obs_type="pixels_agent_pos", image_size=96)
    actions = RIGHT_OF_FIRST_PILLAR + TO_MIDDLE[:10]
    one, _ = play(env, actions, options={"mode": "1 0 0"})
    other, _ = play(env, actions, options={"mode": "1 2 3"})
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a["pixels"]["front"], b["pixels"]["front"])
        assert not np.array_equal(a["goal"], b["goal"])
    assert not np.array_equal(one[0]["pixels"]["front"], one[-1]["pixels"]["front"])


def project(point, size):
    """Row and column at which a pinhole at (1.05, 0, 1.2) with 45 degrees of view, looking 60 degrees down, sees it."""
    offset = np.array(point) - [1.05, 0.0, 1.2]
    forward, right, up = np.array([-0.5, 0, -(0.75**0.5)]), np.array([0, 1, 0]), np.array([-(0.75**0.5), 0, 0.5])
    scale = size / 2 / np.tan(np.pi / 8) / (offset @ forward)
    return round(size / 2 - scale * (offset @ up)), round(size / 2 + scale * (offset @ right))


def test_a_frame_shows_red_pillars_and_a_green_line_where_the_camera_is():
    frame = Slalom(image_size=256).render().astype(int)
    assert frame.shape == (256, 256, 3)
    for x, y in scene.PILLARS:
        red, green, blue = frame[project((x, y, 0.16), 256)]
        assert red > 100 and red > 3 * green and red > 3 * blue
    red, green, blue = frame[project((0.5, 0.35, 0.0), 256)]
    assert green > 90 and green > 2 * red and green > 2 * blue


@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
@pytest.mark.parametrize("use_async", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_lerobot_makes_vector_environments(obs_type, use_async):
    config = SlalomEnv(obs_type=obs_type, image_size=64, mode="1 1 1")
    env = make_env(config, n_envs=2, use_async_envs=use_async)["gloves_slalom"][0]
    try:
        observation, _ = env.reset(seed=[20000, 20001])
        assert env.call("_max_episode_steps") == (300, 300)
        assert env.call("task_description") == ("1 1 1", "1 1 1")
        assert env.call("render")[0].shape == (64, 64, 3)
        assert env.unwrapped.metadata["render_fps"] == 20
        seen = preprocess_observation(observation)
        expected = env_to_policy_features(config)
        assert {key: tuple(value.shape[1:]) for key, value in seen.items()} == {
            key: feature.shape for key, feature in expected.items() if key != "action"
        }
        pillars, image = "observation.environment_state", "observation.images.front"
        assert (pillars in seen, image in seen) == ((True, False) if obs_type == "state" else (False, True))
        for actions in zip(CORRIDOR_111, [(0.0, 0.01)] * len(CORRIDOR_111), strict=True):
            *_, info = env.step(np.array(actions, dtype=np.float32))
            if "final_info" in info and not info["_final_info"][0]:
                assert info["final_info"]["failure"][1] == "collision"
            if "final_info" in info and info["_final_info"][0]:
                break
        assert info["final_info"]["is_success"][0]
    finally:
        env.close()


def test_a_missing_or_unusable_simulator_is_one_clear_line(monkeypatch):
    mujoco = importlib.import_module("mujoco")
    for version in ("3.7.0", "3.10.0", "4.0.0"):
        with monkeypatch.context() as patch:
            patch.setattr(mujoco, "__version__", version)
            with pytest.raises(panda.SimulatorError, match=rf"{version} is installed, but 3.8.1 <= version < 3.10"):
                panda.import_mujoco()
    for package, entry in (("mujoco", panda.import_mujoco), ("robosuite", panda.arm_file)):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)  # what makes find_spec answer that there is none
            with pytest.raises(panda.SimulatorError, match=r"pip install 'lerobot_policy_gloves\[all\]'"):
                entry()


def test_only_tasks_with_an_expert_can_be_recorded():
    check_expert(SlalomEnv())
    with pytest.raises(ValueError, match=r"'pusht' has no scripted expert: choose .*gloves_slalom, metaworld, or"):
        check_expert(PushtEnv())
