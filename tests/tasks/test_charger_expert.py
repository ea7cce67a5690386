"""Charger's scripted expert."""

import copy

import numpy as np
import pytest

from lerobot_gloves.recording.demonstrations import demonstrate
from lerobot_gloves.tasks.charger import ChargerEnv
from lerobot_gloves.tasks.charger.environment import TASK, Charger
from lerobot_gloves.tasks.charger.expert import ChargerExpert
from lerobot_gloves.tasks.charger.kinematics import joint_step
from lerobot_gloves.tasks.charger.scene import turn_of


@pytest.fixture(scope="module")
def env():
    return Charger()


def play(env, seed, rng, *, jostled=False, meddle=lambda expert, observation: None):
    """An episode of the expert: observations, actions and the last info."""
    expert = ChargerExpert(rng)
    observation, info = env.reset(seed=seed)
    expert.reset(env.task)
    observations, actions = [], []
    over = False
    while not over:
        meddle(expert, observation)
        observations.append(observation)
        actions.append(expert.act(observation))
        executed = expert.disturb(actions[-1]) if jostled else actions[-1]
        observation, _, terminated, truncated, info = env.step(executed)
        over = terminated or truncated
    return observations, np.array(actions), info


def test_the_expert_plugs_the_charger_in_never_twice_alike(env):
    played = [play(env, seed, np.random.default_rng(seed)) for seed in range(4)]
    for _, actions, info in played:
        assert info == {"is_success": True, "failure": ""}
        assert 40 < len(actions) < 200 and np.abs(actions).max() <= 1
    again = play(env, 0, np.random.default_rng(0))[1]
    other = play(env, 0, np.random.default_rng(1000))[1]
    assert np.array_equal(again, played[0][1])
    assert np.abs(other[:30] - again[:30]).max() > 0.05


def test_the_expert_decides_from_what_it_sees(env):
    """Whoever has the same draws and takes over at any moment does the same."""

    def take_over(expert, observation):
        other = ChargerExpert(np.random.default_rng(7))
        other.reset(TASK)
        other._rng, other._haste = copy.deepcopy(expert._rng), expert._haste  # the speed alone drifts
        assert np.array_equal(other.act(observation), copy.deepcopy(expert).act(observation))

    assert play(env, 1, np.random.default_rng(7), meddle=take_over)[2]["is_success"]


def test_the_expert_picks_up_again_what_it_lost(env):
    lost = []

    def take_away(expert, observation):
        if not lost and observation["environment_state"][2] > 0.05:  # while it carries the charger
            import sapien

            env._scene._charger.pose = sapien.Pose([-0.08, 0.05, 0.012])
            env._scene._charger.components[0].linear_velocity = [0, 0, 0]
            env._scene._charger.components[0].angular_velocity = [0, 0, 0]
            lost.append(True)
        elif lost:
            lost.append(observation["agent_pos"][7:9].sum() > 0.07)

    _, _, info = play(env, 2, np.random.default_rng(3), meddle=take_away)
    assert any(lost[1:]) and info["is_success"]


def test_the_expert_opens_empty_fingers_wherever_they_are(env):
    around = []

    def empty(expert, observation):
        shut = {**observation, "agent_pos": observation["agent_pos"].copy()}
        shut["agent_pos"][7:9] = 0.0
        around.append(np.linalg.norm(observation["agent_pos"][18:21] - observation["environment_state"][:3]) < 0.03)
        assert copy.deepcopy(expert).act(shut)[7] == 1

    assert play(env, 1, np.random.default_rng(5), meddle=empty)[2]["is_success"] and any(around)


def test_joints_move_the_tool_as_it_shall_move(env):
    import sapien

    rng = np.random.default_rng(0)
    for _ in range(10):
        env.reset(seed=int(rng.integers(1000)))
        robot, before = env._scene._robot, env._scene.tool
        twist = np.array([*rng.uniform(-0.003, 0.003, 3), *rng.uniform(-0.01, 0.01, 3)])
        start = robot.qpos.astype(np.float64)
        robot.qpos = start + np.array([*joint_step(start, twist), 0, 0])
        after: sapien.Pose = before.inv() * env._scene.tool
        assert after.p == pytest.approx(twist[:3], abs=2e-4)
        assert turn_of(after.q) == pytest.approx(twist[3:], abs=5e-4)


def test_jostling_spares_pegs_in_the_holes_and_fingers_that_hold(env):
    far, inside, empty = [], [], []
    wanted = np.array([0, 0, 0, 0, 0, 0, 0, 1], dtype=np.float32)

    def watch(expert, observation):
        depth = np.linalg.norm(observation["environment_state"][:3] - observation["goal"][7:10])
        pushed = copy.deepcopy(expert)
        opening = pushed.act(observation)[7]
        pushed._slips = False
        executed = np.array([pushed.disturb(wanted) for _ in range(100)])
        assert np.abs(executed).max() <= 1 and set(executed[:, 7]) <= {-1, 1}
        (inside if depth < 0.015 else far).append(np.abs(executed[:, :7]).max())
        if opening == 1:
            empty.append(np.mean(executed[:, 7] < 0))
        elif depth < 0.1:  # it is carried
            assert (executed[:, 7] == 1).all()

    for seed in (3, 4):
        assert play(env, seed, np.random.default_rng(seed), jostled=True, meddle=watch)[2]["is_success"]
    # Bumps, which come in some of a hundred steps wherever there are any, are larger than what else there is.
    assert np.median(far) > 0.05 and max(inside) < 0.02
    assert 0.02 < np.mean(empty) < 0.3  # in the long run one step in eleven


def test_recorded_demonstrations_carry_their_labels(env):
    whole, hidden = ChargerEnv(), ChargerEnv(hide_receptacle=True)
    shown = demonstrate(whole, env, 30001)
    unshown = demonstrate(hidden, Charger(**hidden.demonstration_kwargs), 30001)
    for config, episode in ((whole, shown), (hidden, unshown)):
        assert episode.task == TASK and (episode.frames["mode"] == 0).all()
        length = len(episode.frames["action"])
        for key, names in config.feature_names.items():
            assert episode.frames[key].shape == (length, len(names))
    assert np.array_equal(shown.frames["action"], unshown.frames["action"])
    key = "observation.environment_state"
    assert np.array_equal(shown.frames[key][:, :13], unshown.frames[key])


@pytest.mark.slow
def test_the_expert_hardly_ever_fails(env):
    outcomes = [play(env, 60000 + i, np.random.default_rng([1, i]), jostled=True)[2] for i in range(60)]
    assert np.mean([info["is_success"] for info in outcomes]) >= 0.95
