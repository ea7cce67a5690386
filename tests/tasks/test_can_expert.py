"""CAN's scripted expert."""

import numpy as np
import pytest

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.recording.demonstrations import demonstrate
from lerobot_gloves.tasks.can import CanEnv, scene
from lerobot_gloves.tasks.can.environment import Can
from lerobot_gloves.tasks.can.expert import CanExpert


@pytest.fixture(scope="module")
def env():
    return Can()


def play(env, seed, rng, *, jostled=False, meddle=lambda step, observation: None):
    """An episode of the expert: observations, actions and the last info."""
    expert = CanExpert(rng)
    observation, info = env.reset(seed=seed)
    expert.reset(env.task)
    observations, actions = [], []
    over = False
    while not over:
        observations.append(observation)
        actions.append(expert.act(observation))
        meddle(len(actions), observation)
        executed = expert.disturb(actions[-1]) if jostled else actions[-1]
        observation, _, terminated, truncated, info = env.step(executed)
        over = terminated or truncated
    return observations, np.array(actions), info


def test_the_expert_fills_every_quadrant_never_twice_alike(env):
    played = [play(env, seed, np.random.default_rng(seed)) for seed in range(4)]
    for observations, actions, info in played:
        assert info == {"is_success": True, "failure": ""}
        assert 70 < len(actions) < 250 and np.abs(actions).max() <= 1
        assert len(observations) == len(actions)
    again = play(env, 0, np.random.default_rng(0))[1]
    other = play(env, 0, np.random.default_rng(1000))[1]
    assert np.array_equal(again, played[0][1])
    assert np.abs(other[:50] - again[:50]).max() > 0.05


def test_the_expert_decides_from_what_it_sees(env):
    """Two experts with the same draws, one of whom has only joined for the second half, end the episode alike."""
    observations, actions, _ = play(env, 1, np.random.default_rng(7))
    late = CanExpert(np.random.default_rng(7))
    late.reset(scene.MODES[1])
    late._via = None
    late._haste = 0.0
    half = len(actions) // 2
    for observation, action in zip(observations[half:], actions[half:], strict=True):
        assert np.sign(late.act(observation)[6]) == np.sign(action[6])


def test_the_expert_picks_up_again_what_it_lost(env):
    lost = []

    def take_away(step, observation):
        if not lost and observation["environment_state"][2] > 0.97:  # while it carries the can
            env._data.qpos[9:] = [0.05, -0.3, 0.8603, 1, 0, 0, 0]
            env._data.qvel[9:15] = 0
            lost.append(step)

    _, actions, info = play(env, 2, np.random.default_rng(3), meddle=take_away)
    assert lost and info["is_success"]
    assert (actions[lost[0] :, 6] < 0).any()  # it opened the hand and began anew


def test_jostling_leaves_the_fingers_alone_and_is_steered_against(env):
    expert = CanExpert(np.random.default_rng(1))
    expert.reset("top left")
    wanted = np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0, 1.0], dtype=np.float32)
    pushed = np.array([expert.disturb(wanted) for _ in range(200)])
    assert (pushed[:, 6] == 1).all() and np.abs(pushed).max() <= 1
    assert (pushed[:, :6].std(axis=0) > 0.01).all()
    sideways = lambda step: np.array([0.0, 0.5 if step < 10 else 0.0, 0, 0.3 if step < 10 else 0.0, 0, 0, 0])  # noqa: E731
    observation, _ = env.reset(seed=0)
    straight = expert.act(observation)
    for step in range(10):
        observation, *_ = env.step(sideways(step))
    assert expert.act(observation)[1] < straight[1] - 0.1  # it was carried to +y
    assert expert.act(observation)[3] < straight[3] - 0.02  # and turned about +x


def test_some_experts_first_set_out_for_another_quadrant():
    """A hand that does as it is told, without physics, carries the can to the top left, by way of larger x or not."""
    reached = []
    for draw in range(60):
        expert = CanExpert(np.random.default_rng(draw))
        expert.reset("top left")
        grip, way = np.array([0.0, -0.2, 1.0]), []
        for _ in range(150):
            hand = [*grip, 0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.05]  # points down and holds
            can = grip - [0.0, 0.0, 0.015]
            action = expert.act({"agent_pos": np.array(hand), "environment_state": np.array([*can, 0, 0, 1])})
            if action[6] < 0:
                break
            grip = grip + 0.0125 * action[:3]
            way.append(grip)
        assert scene.quadrant_of(can) == 0 and np.linalg.norm(can[:2] - scene.quadrant_centre(0)) < 0.08
        over = np.array(way)[np.array(way)[:, 1] > 0.05]
        reached.append(over[:, 0].max())
        assert over[over[:, 0] > 0.1, 2].min(initial=1.0) > 0.95  # other quadrants are only flown over
    # Three of ten set out elsewhere, half of these to a bottom quadrant, the farthest of them well beyond x = 0.1.
    assert 3 <= sum(x > 0.13 for x in reached) <= 15


def test_recorded_demonstrations_carry_their_labels(env):
    config = CanEnv()
    for seed in (30001, 30002):
        episode = demonstrate(config, env, seed)
        quadrant = seed % 4
        assert episode.task == scene.MODES[quadrant]
        assert (episode.frames["mode"] == quadrant).all()
        assert (episode.frames["observation.goal"] == np.eye(4)[quadrant]).all()
        length = len(episode.frames["action"])
        for key, names in config.feature_names.items():
            assert episode.frames[key].shape == (length, len(names))
        last = episode.frames["observation.environment_state"][-1]
        assert scene.quadrant_of(last[:3]) == quadrant


def test_the_expert_sees_the_can_where_pixels_are_recorded(env):
    config = CanEnv(obs_type="pixels_agent_pos", image_size=16)
    assert "environment_state" not in config.features
    watched = Can(**config.demonstration_kwargs)
    observations, actions, info = play(watched, 3, np.random.default_rng(0))
    assert info["is_success"] and set(observations[0]["pixels"]) == {"third_person", "wrist"}
    assert np.array_equal(actions, play(env, 3, np.random.default_rng(0))[1])
    episode = demonstrate(config, watched, 30003)  # without what only the expert sees
    assert episode.frames.keys() == {*config.features_map.values(), "mode"}


@pytest.mark.slow
def test_the_expert_hardly_ever_fails(env):
    outcomes = [play(env, 60000 + i, np.random.default_rng([1, i]), jostled=True)[2] for i in range(30)]
    assert np.mean([info["is_success"] for info in outcomes]) >= 0.96
