import math
import sys

import numpy as np
import pytest
from lerobot.envs import make_env, preprocess_observation
from lerobot.envs.utils import env_to_policy_features
from scipy.spatial.transform import Rotation

from lerobot_gloves.tasks.charger import ChargerEnv, simulator
from lerobot_gloves.tasks.charger.environment import TASK, Charger
from lerobot_gloves.tasks.charger.scene import is_plugged_in, turn_of
from lerobot_gloves.tasks.panda import SimulatorError

STAY = np.array([0.0] * 7 + [1.0], dtype=np.float32)


@pytest.fixture(scope="module")
def env():
    return Charger()


def raw_environment():
    """ManiSkill's environment as it is, made anew, since its episodes depend on what it has played before."""
    with simulator.without_graphics():
        return simulator.plug_charger(obs_mode="state", render_backend="none")


def actions(seed, steps=60):
    """Actions that soon press the hand on the table, where the smallest difference shows."""
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(-0.3, 0.3, (steps, 8))
    drawn[:, 1] += 0.3
    drawn[:, 7] = rng.choice([-1.5, 1.0], steps)  # beyond what is allowed, too
    return drawn.astype(np.float32)


def play(env, seed, steps=60):
    """All that is observed in an episode of `actions`, bit by bit."""
    observation, _ = env.reset(seed=seed)
    seen = [observation]
    for action in actions(seed, steps):
        observation, *_ = env.step(action)
        seen.append(observation)
    return np.array([np.concatenate([o["agent_pos"], o["environment_state"], o["goal"]]) for o in seen])


def same_pose(ours, theirs):
    """Equal positions, and quaternions that are equal or opposite."""
    sign = np.sign((ours[..., 3:] * theirs[..., 3:]).sum(axis=-1, keepdims=True))
    assert np.array_equal(ours[..., :3], theirs[..., :3])
    assert np.array_equal(ours[..., 3:], sign * theirs[..., 3:])


def test_an_episode_is_maniskills_to_the_bit(env):
    for seed in (2, 4, 5):
        raw = raw_environment()
        observation, _ = raw.reset(seed=seed)
        theirs = [observation[0].numpy()]
        for action in actions(seed):
            theirs.append(raw.step(action)[0][0].numpy())
        theirs, ours = np.array(theirs), play(env, seed)
        # ManiSkill's 46: joints and velocities, then the poses of tool, charger, receptacle and goal.
        assert np.array_equal(ours[:, :18], theirs[:, :18])
        same_pose(ours[:, 18:25], theirs[:, 18:25])
        same_pose(ours[:, 25:32], theirs[:, 25:32])
        for start, place in ((38, 32), (51, 32), (58, 39)):
            same_pose(ours[:1, start : start + 7], theirs[:1, place : place + 7])
        for still in (slice(38, 45), slice(51, 65)):  # what stands still is not measured again
            assert (ours[:, still] == ours[0, still]).all()
        assert np.abs(theirs[:, 32:] - theirs[0, 32:]).max() < 1e-6


def test_success_is_maniskills(env):
    import sapien

    raw, rng, seen = raw_environment(), np.random.default_rng(0), []
    raw.reset(seed=0)
    goal = raw.goal_pose.sp
    for _ in range(300):
        way, axis = rng.standard_normal(3), rng.standard_normal(3)
        way *= rng.uniform(0.003, 0.007) / np.linalg.norm(way)
        turned = Rotation.from_rotvec(rng.uniform(0.1, 0.3) * axis / np.linalg.norm(axis)).as_quat(scalar_first=True)
        charger = goal * sapien.Pose(way, turned)
        raw.charger.set_pose(charger)
        seen.append(is_plugged_in(charger, goal))
        assert seen[-1] == bool(raw.evaluate()["success"])
    assert 50 < sum(seen) < 100  # a quarter: half are near enough, and half of these straight enough


def test_a_charger_in_the_receptacle_is_a_success(env):
    import sapien

    env.reset(seed=0)
    for depth, plugged in ((-0.03, False), (-0.004, True)):
        env._scene._charger.pose = env._scene.goal * sapien.Pose([depth, 0, 0])
        env._scene._charger.components[0].linear_velocity = [0, 0, 0]
        _, reward, terminated, truncated, info = env.step(STAY)
        assert (reward, terminated, truncated) == (float(plugged), plugged, False)
        assert info == {"is_success": plugged, "failure": ""}


def test_rotation_vectors_are_scipys():
    rotations = Rotation.random(50, random_state=0)
    for rotation, quaternion in zip(rotations, rotations.as_quat(scalar_first=True), strict=True):
        for sign in (1, -1):
            assert turn_of(sign * quaternion) == pytest.approx(rotation.as_rotvec(), abs=1e-9)
    assert turn_of(np.array([1.0, 0.0, 0.0, 0.0])).tolist() == [0, 0, 0]


def relative(pose, other):
    """Position and rotation vector of a pose (7,) seen from another, by SciPy."""
    (place, turn), (origin, frame) = ((p[:3], Rotation.from_quat(p[3:], scalar_first=True)) for p in (pose, other))
    return frame.inv().apply(place - origin), (frame.inv() * turn).as_rotvec()


def test_offsets_are_relative_poses_magnified_near_zero(env):
    for seed, steps in ((2, 0), (4, 60)):
        seen = play(env, seed, steps)[-1].astype(np.float64)
        tool, charger, goal = seen[18:25], seen[25:32], seen[58:65]
        # The tool shall point down: half a turn about the charger's x.
        down = Rotation.from_quat(charger[3:], scalar_first=True) * Rotation.from_rotvec([np.pi, 0, 0])
        grip = np.concatenate([charger[:3], down.as_quat(scalar_first=True)])
        for offset, (way, turn) in ((seen[32:38], relative(tool, grip)), (seen[45:51], relative(charger, goal))):
            # Millimetres and hundredths of a radian.
            assert 1000 * way == pytest.approx(np.sinh(offset[:3]), rel=1e-3, abs=1e-3)
            assert 100 * turn == pytest.approx(np.sinh(offset[3:]), rel=1e-3, abs=1e-3)


def test_same_seed_and_actions_give_the_same_episode_whatever_was_played_before(env):
    expected = {seed: play(env, seed) for seed in (2, 4, 5)}
    other = Charger()
    for seed in (5, 4, 2, 4):
        play(env, 7, steps=seed)
        assert np.array_equal(play(env, seed), expected[seed])
        assert np.array_equal(play(other, seed), expected[seed])


def test_environments_in_one_process_do_not_touch_each_other(env):
    alone, other = play(env, 3), Charger()
    observation, _ = env.reset(seed=3)
    other.reset(seed=4)
    for action, before in zip(actions(3), alone, strict=False):
        assert np.array_equal(observation["agent_pos"], before[:25])
        observation, *_ = env.step(action)
        other.step(-action)


def test_global_random_generators_are_left_alone(env):
    import torch

    torch.manual_seed(1)
    np.random.seed(1)
    expected = torch.rand(3), np.random.rand(3)
    torch.manual_seed(1)
    np.random.seed(1)
    env.reset(seed=9)
    assert torch.equal(torch.rand(3), expected[0]) and np.array_equal(np.random.rand(3), expected[1])


def test_an_action_moves_joints_from_where_they_are(env):
    begin, _ = env.reset(seed=0)
    for joint in range(7):
        env.reset(seed=0)
        for _ in range(5):
            after, *_ = env.step(np.eye(8, dtype=np.float32)[joint] * 0.5 + STAY)
        moved = (after["agent_pos"] - begin["agent_pos"])[:7]
        # The servos take the 0.05 rad a step up slowly.
        assert 0.04 < moved[joint] < 0.25 and np.abs(np.delete(moved, joint)).max() < 0.02
    for opening, width in ((1.0, 0.08), (0.2, 0.04), (-1.0, 0.0)):
        env.reset(seed=0)
        for _ in range(20):
            after, *_ = env.step(np.array([0, 0, 0, 0, 0, 0, 0, opening]))
        # 1 is 4 cm a finger, -1 is 1 cm beyond the middle: 0.2 is 2.1 cm.
        assert after["agent_pos"][7:9].sum() == pytest.approx(width, abs=0.003)


def test_time_runs_out_after_300_steps(env):
    env.reset(seed=0)
    outcomes = [env.step(STAY)[1:] for _ in range(300)]
    quiet = (0.0, False, False, {"is_success": False, "failure": ""})
    assert outcomes[:-1] == [quiet] * 299
    assert outcomes[-1] == (0.0, False, True, {"is_success": False, "failure": "timeout"})


def test_a_seed_chooses_where_everything_is(env):
    charger, receptacle, goal, tool = [], [], [], []
    for seed in range(30000, 30200):
        observation, _ = env.reset(seed=seed)
        charger.append(observation["environment_state"][:7])
        receptacle.append(observation["environment_state"][13:20])
        goal.append(observation["goal"])
        tool.append(observation["agent_pos"][18:25])
    charger, receptacle, goal, tool = map(np.array, (charger, receptacle, goal, tool))
    assert np.array_equal(goal[:, :7], receptacle)
    # ManiSkill's ranges, and that 200 draws come near their ends.
    for values, low, high in (
        (charger[:, 0], -0.1, -0.026),
        (charger[:, 1], -0.2, 0.2),
        (2 * np.arctan2(charger[:, 6], charger[:, 3]), -math.pi / 3, math.pi / 3),
        (receptacle[:, 0], 0.01, 0.1),
        (receptacle[:, 1], -0.1, 0.1),
        (2 * np.arctan2(goal[:, 13], goal[:, 10]), -math.pi / 8, math.pi / 8),
    ):
        room = 0.03 * (high - low)
        assert low <= values.min() < low + room and high - room < values.max() <= high
    assert charger[:, 2] == pytest.approx(0.012) and receptacle[:, 2] == pytest.approx(0.1)
    # The charger's pegs shall point into the receptacle, whose x points out of it: half a turn between them.
    for pose, end in zip(receptacle[:20], goal[:20, 7:], strict=True):
        between = Rotation.from_quat(pose[3:], scalar_first=True).inv() * Rotation.from_quat(end[3:], scalar_first=True)
        assert between.as_matrix() == pytest.approx(np.diag([-1, -1, 1]), abs=1e-5)
        assert np.array_equal(pose[:3], end[:3])
    # Signs of quaternions never jump: the entry that settles them is far from 0.
    for pose, entry in ((charger, 3), (receptacle, 6), (goal[:, 7:], 3), (tool, 4)):
        assert pose[:, entry].min() > 0.8


def test_without_a_seed_poses_are_drawn(env):
    env.reset(seed=5)
    drawn = [env.reset()[0]["goal"].tolist() for _ in range(3)]
    env.reset(seed=5)
    assert drawn == [env.reset()[0]["goal"].tolist() for _ in range(3)]
    assert drawn[0] != drawn[1] != drawn[2]
    assert env.task == env.task_description == TASK


def test_the_receptacle_can_be_hidden_from_whoever_does_not_know_the_goal(env):
    config = ChargerEnv(hide_receptacle=True)
    hidden = Charger(**config.gym_kwargs)
    observation, whole = hidden.reset(seed=3)[0], env.reset(seed=3)[0]
    assert np.array_equal(observation["environment_state"], whole["environment_state"][:13])
    # Who knows the goal is told how far it is: only the other loses by the hiding.
    assert np.array_equal(observation["goal"], np.concatenate([whole["goal"], whole["environment_state"][20:]]))
    assert hidden.observation_space.contains(observation)
    for options, scene, goal in (({}, 26, 14), ({"hide_receptacle": True}, 13, 20)):
        config = ChargerEnv(**options)
        for key, length in (("environment_state", scene), ("goal", goal)):
            assert config.features[key].shape == (length,)
            assert len(config.feature_names[f"observation.{key}"]) == length
    for make in (ChargerEnv, Charger):
        with pytest.raises(ValueError, match="hides the receptacle with obs_type state only, not pixels_agent_pos"):
            make(obs_type="pixels_agent_pos", hide_receptacle=True)


def test_lerobot_makes_vector_environments():
    config = ChargerEnv()
    env = make_env(config, n_envs=2, use_async_envs=False)["gloves_charger"][0]
    try:
        observation, _ = env.reset(seed=[20000, 20001])
        assert env.call("_max_episode_steps") == (300, 300)
        assert env.call("task_description") == (TASK, TASK)
        assert env.unwrapped.metadata["render_fps"] == 20
        seen = preprocess_observation(observation)
        expected = env_to_policy_features(config)
        assert {key: tuple(value.shape[1:]) for key, value in seen.items()} == {
            key: feature.shape for key, feature in expected.items() if key != "action"
        }
        _, rewards, *_ = env.step(np.zeros((2, 8), dtype=np.float32))
        assert rewards.tolist() == [0.0, 0.0]
    finally:
        env.close()


@pytest.mark.parametrize("package", ["mani_skill", "sapien"])
def test_a_missing_simulator_is_one_clear_line(monkeypatch, package):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, package, None)  # what makes find_spec answer that there is none
        with pytest.raises(SimulatorError, match=r"pip install 'lerobot_policy_gloves\[charger\]'") as error:
            Charger()
    assert "\n" not in str(error.value)
