import subprocess
import sys

import numpy as np
import pytest
from lerobot.envs import make_env, preprocess_observation
from lerobot.envs.utils import env_to_policy_features

from lerobot_gloves.tasks import panda
from lerobot_gloves.tasks.can import CanEnv, scene
from lerobot_gloves.tasks.can.environment import SETTLED_STEPS, Can
from lerobot_gloves.tasks.can.expert import CanExpert

STAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])
AWAY = {"top left": (0.0, 0.16), "top right": (0.0, 0.4), "bottom left": (0.2, 0.16), "bottom right": (0.2, 0.4)}
"""Where (x, y) a can stands in each quadrant."""


@pytest.fixture(scope="module")
def env():
    return Can()


def put(env, position):
    """Stand the can somewhere (x, y, z); for the environment it has only just come there."""
    env._settled = 0
    env._data.qpos[9:] = [*position, 1, 0, 0, 0]
    env._data.qvel[9:15] = 0


def stay(env, steps, action=STAY):
    """Repeat an action until the steps or the episode end; the last step's outcome, and how many steps there were."""
    count, over = 0, False
    while count < steps and not over:
        _, reward, terminated, truncated, info = env.step(action)
        count, over = count + 1, terminated or truncated
    return (reward, terminated, truncated, info), count


def test_the_instructions_are_the_papers():
    assert scene.MODES == (
        "Pick up the can and place it in the top left of the destination bin.",
        "Pick up the can and place it in the top right of the destination bin.",
        "Pick up the can and place it in the bottom left of the destination bin.",
        "Pick up the can and place it in the bottom right of the destination bin.",
    )


def test_quadrants_lie_between_the_walls():
    for number, name in enumerate(scene.QUADRANTS):
        assert scene.quadrant_of(np.array([*AWAY[name], 0.86])) == number
        assert scene.quadrant_of(np.array([*scene.quadrant_centre(number), 0.86])) == number
    for nowhere in ((0.0, -0.2, 0.86), (0.0, 0.16, 0.95), (0.0, 0.16, 0.5), (0.4, 0.16, 0.86), (0.0, 0.6, 0.86)):
        assert scene.quadrant_of(np.array(nowhere)) is None


def test_a_can_left_in_the_requested_quadrant_is_a_success(env):
    for name, place in AWAY.items():
        env.reset(seed=0, options={"mode": name})
        assert stay(env, 20)[0] == (0.0, False, False, {"is_success": False, "failure": ""})
        put(env, (*place, 0.8603))
        outcome, count = stay(env, 20)
        assert outcome == (1.0, True, False, {"is_success": True, "failure": ""})
        assert count == SETTLED_STEPS


def test_a_can_that_has_not_settled_is_no_success_yet(env):
    env.reset(seed=0, options={"mode": "bottom right"})
    put(env, (0.2, 0.4, 0.8603))
    assert not stay(env, SETTLED_STEPS - 1)[0][1]
    for sign in (1, -1) * 10:  # shaken in the right quadrant, from the last moment on
        env._data.qpos[11] = 0.88
        env._data.qvel[9:12] = [0.0, 0.3 * sign, 0.0]
        outcome, _ = stay(env, 1)
        assert scene.quadrant_of(env._data.qpos[9:12]) == 3
        assert outcome == (0.0, False, False, {"is_success": False, "failure": ""})
    put(env, (0.2, 0.4, 0.89))  # falls from 3 cm
    outcome, count = stay(env, 40)
    assert outcome[3]["is_success"] and count > SETTLED_STEPS


def test_success_needs_letting_go():
    env = Can()
    observation, _ = env.reset(seed=2)
    expert = CanExpert(np.random.default_rng(0))
    expert.reset(env.task)
    carried = False
    while True:
        action = expert.act(observation)
        carried = carried or observation["environment_state"][2] > 0.95
        if carried and action[6] < 0:
            break
        observation, *_ = env.step(action)
    held = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    outcome, count = stay(env, 40, held)
    assert scene.quadrant_of(env._data.qpos[9:12]) == 2
    assert np.linalg.norm(env._data.qvel[9:12]) < 0.02  # it rests, in the right place, in the hand
    assert (outcome, count) == ((0.0, False, False, {"is_success": False, "failure": ""}), 40)
    outcome, _ = stay(env, 40)
    assert outcome[3]["is_success"]


def test_failures_are_told_apart():
    env = Can(episode_length=30, mode="top left")
    for place, failure in (
        ((0.0, -0.2, 0.8603), "timeout"),  # in the source bin
        ((0.2, 0.4, 0.8603), "wrong_quadrant"),
    ):
        env.reset(seed=0)
        put(env, place)
        assert stay(env, 40) == ((0.0, False, True, {"is_success": False, "failure": failure}), 30)
    env.reset(seed=0)
    stay(env, 29)
    put(env, (0.2, 0.4, 0.89))  # in another quadrant, but still falling
    assert stay(env, 1)[0][3]["failure"] == "timeout"
    env.reset(seed=0)
    put(env, (0.5, 0.0, 0.85))  # beside the bins: it falls to the floor
    outcome, count = stay(env, 30)
    assert outcome == (0.0, True, False, {"is_success": False, "failure": "dropped"})
    # Free fall from 0.85 m to 0.8 m takes 0.101 s, two control steps and a bit.
    assert count == 3


def test_time_runs_out_after_400_steps(env):
    env.reset(seed=0)
    assert stay(env, 500) == ((0.0, False, True, {"is_success": False, "failure": "timeout"}), 400)


def test_an_action_moves_and_turns_the_hand_and_closes_the_fingers(env):
    start, _ = env.reset(seed=0)
    for axis in range(3):
        env.reset(seed=0)
        for _ in range(10):
            after, *_ = env.step(0.5 * np.eye(7)[axis])
        moved = after["agent_pos"][:3] - start["agent_pos"][:3]
        # The goal runs 2.5 cm ahead: 10 steps go some 5 cm that way, and little aside.
        assert 0.03 < moved[axis] < 0.08 and np.abs(np.delete(moved, axis)).max() < 0.01
        env.reset(seed=0)
        for _ in range(5):
            after, *_ = env.step(0.3 * np.eye(7)[3 + axis])
        before, now = start["agent_pos"][3:7], after["agent_pos"][3:7]
        assert np.linalg.norm(now) == pytest.approx(1, abs=1e-5)
        # Vector part of now * conjugate(before): half of the rotation vector, in the world frame.
        turned = 2 * (before[0] * now[1:] - now[0] * before[1:] - np.cross(now[1:], before[1:]))
        assert turned[axis] > 0.1 and np.abs(np.delete(turned, axis)).max() < 0.4 * turned[axis]
    for command, width in ((-1.0, 0.08), (1.0, 0.0)):
        env.reset(seed=0)
        for _ in range(30):
            after, *_ = env.step(np.array([0, 0, 0, 0, 0, 0, command]))
        assert after["agent_pos"][7] == pytest.approx(width, abs=0.003)


def test_an_observation_says_where_hand_and_can_are(env):
    observation, _ = env.reset(seed=1)
    state, can = observation["agent_pos"], observation["environment_state"]
    assert can[6:] == pytest.approx(can[:3] - state[:3], abs=1e-6)
    assert can[3:6] == pytest.approx([0, 0, 1], abs=1e-3)
    assert state[3:7] == pytest.approx([0, 0.707, 0.707, 0], abs=0.06)  # points down, up to the initial noise
    env._data.qpos[9:] = [0.1, 0.28, 1.0, np.sqrt(0.5), np.sqrt(0.5), 0, 0]  # a quarter turn about x
    env._mujoco.mj_forward(env._model, env._data)
    can = env._observation()["environment_state"]
    assert can[:6] == pytest.approx([0.1, 0.28, 1.0, 0, -1, 0], abs=1e-6)


def test_a_seed_chooses_the_quadrant_and_where_everything_starts(env):
    cans, joints = [], []
    for seed in range(30000, 30200):
        observation, _ = env.reset(seed=seed)
        assert env.task_description == scene.MODES[seed % 4]
        assert observation["goal"].tolist() == np.eye(4)[seed % 4].tolist()
        cans.append(env._data.qpos[9:11].copy())
        joints.append(env._data.qpos[:7].copy())
    offsets = np.array(cans) - [0.1, -0.25]
    assert (np.abs(offsets) <= [0.12, 0.17]).all()
    assert (offsets.max(axis=0) > [0.11, 0.16]).all() and (offsets.min(axis=0) < [-0.11, -0.16]).all()
    assert np.std(joints, axis=0) == pytest.approx(0.02, rel=0.2)


def test_without_a_seed_quadrants_are_drawn_and_a_fixed_one_stays():
    env = Can()
    env.reset(seed=5)
    drawn = [(env.reset()[0]["environment_state"][0], env.task) for _ in range(12)]
    env.reset(seed=5)
    assert drawn == [(env.reset()[0]["environment_state"][0], env.task) for _ in range(12)]
    assert len({task for _, task in drawn}) == 4
    fixed = Can(mode="bottom left")
    fixed.reset(seed=3)
    assert fixed.task == fixed.task_description == scene.MODES[2]
    fixed.reset(seed=3, options={"mode": scene.MODES[1]})
    assert fixed.task == scene.MODES[1]


def test_same_actions_give_the_same_numbers_bit_for_bit():
    def play(env, seed, steps):
        observation, _ = env.reset(seed=seed)
        expert = CanExpert(np.random.default_rng(seed))
        expert.reset(env.task)
        states = [env._data.qpos.copy()]
        # The expert reads the first environment's observations; the others repeat its actions.
        for step in range(steps):
            if len(actions) <= step:
                actions.append(expert.act(observation))
            observation, *_ = env.step(actions[step])
            states.append(np.concatenate([env._data.qpos, env._data.qvel, observation["agent_pos"]]))
        return states

    actions = []
    first, second = Can(), Can(obs_type="pixels_agent_pos", image_size=32)
    expected = play(first, 6, 100)
    assert expected[-1][11] > 0.9  # the can is in the hand: contacts and all
    play(first, 3, 70)
    for env in (first, second):  # after another episode, and whether or not frames are drawn
        for before, after in zip(expected, play(env, 6, 100), strict=True):
            assert np.array_equal(before, after)


@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
@pytest.mark.parametrize("use_async", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_lerobot_makes_vector_environments(obs_type, use_async):
    config = CanEnv(obs_type=obs_type, image_size=32, mode="top right")
    env = make_env(config, n_envs=2, use_async_envs=use_async)["gloves_can"][0]
    try:
        observation, _ = env.reset(seed=[20000, 20001])
        assert env.call("_max_episode_steps") == (400, 400)
        assert env.call("task_description") == (scene.MODES[1],) * 2
        assert env.call("render")[0].shape == (32, 32, 3)
        assert env.unwrapped.metadata["render_fps"] == 20
        seen = preprocess_observation(observation)
        expected = env_to_policy_features(config)
        assert {key: tuple(value.shape[1:]) for key, value in seen.items()} == {
            key: feature.shape for key, feature in expected.items() if key != "action"
        }
        images = {"observation.images.third_person", "observation.images.wrist"}
        assert images & set(seen) == (set() if obs_type == "state" else images)
        assert ("observation.environment_state" in seen) == (obs_type == "state")
        _, rewards, *_ = env.step(np.zeros((2, 7), dtype=np.float32))
        assert rewards.tolist() == [0.0, 0.0]
    finally:
        env.close()


def test_a_missing_robosuite_is_one_clear_line(monkeypatch):
    build = scene._xml.__wrapped__
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "robosuite", None)  # what makes find_spec answer that there is none
        with pytest.raises(panda.SimulatorError, match=r"pip install 'lerobot_policy_gloves\[can\]'") as error:
            build()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_robosuite_says_nothing():
    code = (
        "import lerobot_gloves.tasks, gymnasium as gym\n"
        "env = gym.make('gloves/Can-v0', obs_type='pixels_agent_pos', image_size=32, disable_env_checker=True)\n"
        "env.reset(seed=0); env.step(env.action_space.sample()); env.close()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")
