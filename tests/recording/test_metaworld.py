"""MetaWorld, as LeRobot has it, played by its own experts.

What is rendered here is a stand-in: pictures are none of the expert's business.
"""

import sys

import numpy as np
import pytest
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.envs import env_to_policy_features, make_env
from lerobot.envs.configs import MetaworldEnv
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_gloves.commands.record import RecordConfig, RecordedDatasetConfig, record
from lerobot_gloves.evaluation.environments import environments
from tests.builders import save_policy
from tests.metaworld import draw

TASKS = {"reach-v3": "Reach a goal position", "drawer-close-v3": "Push and close a drawer"}
SEED = 30000


@pytest.fixture(autouse=True, scope="module")
def drawn():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MujocoRenderer, "render", draw)
        yield


def config(root, **options) -> RecordConfig:
    env = MetaworldEnv(task=options.pop("task", ",".join(TASKS)))
    agent = options.pop("agent", None)
    named = RecordedDatasetConfig(repo_id="me/metaworld", root=root, **options)
    return RecordConfig(env=env, dataset=named, agent=agent, batch_size=1)


@pytest.fixture(scope="module")
def demonstrated(tmp_path_factory) -> LeRobotDataset:
    root = tmp_path_factory.mktemp("metaworld") / "data"
    record(config(root, num_episodes=2))
    return LeRobotDataset("me/metaworld", root=root)


def test_what_is_recorded_is_what_a_policy_will_see(demonstrated):
    """`lerobot-eval` and `lerobot-train` each make a policy's features by a function of LeRobot's: they must agree."""
    shown = env_to_policy_features(MetaworldEnv(task="reach-v3"))
    assert dataset_to_policy_features(demonstrated.meta.features) == shown
    assert (demonstrated.fps, demonstrated.meta.robot_type) == (80, "metaworld")
    assert [demonstrated.meta.episodes["tasks"][index] for index in range(2)] == [[text] for text in TASKS.values()]


def test_its_actions_do_the_same_again(demonstrated):
    """In environments of their own, made by LeRobot and seeded as its evaluation seeds them."""
    rows = demonstrated.hf_dataset
    actions, states, episodes = (np.stack(rows[key]) for key in ("action", "observation.state", "episode_index"))
    assert np.abs(actions).max() == 1  # the experts ask for more
    for index, task in enumerate(TASKS):
        env = make_env(MetaworldEnv(task=task), n_envs=1)[task][0]
        observation, _ = env.reset(seed=[SEED + index])
        played = (episodes == index).nonzero()[0]
        for row in played:
            assert np.array_equal(states[row], observation["agent_pos"][0].astype(np.float32))
            if row in played[::25]:
                picture = (demonstrated[int(row)]["observation.image"] * 255).round().byte().permute(1, 2, 0)
                assert np.array_equal(picture.numpy(), observation["pixels"][0])
            observation, _, terminated, truncated, info = env.step(actions[row][None])
            assert (terminated[0], bool(info["is_success"][0])) == (row == played[-1], row == played[-1])
            assert not truncated[0]
        env.close()


def test_an_agent_is_recorded_without_an_expert(tmp_path, demonstrated, monkeypatch):
    from lerobot.envs.metaworld import MetaworldEnv as Simulation

    monkeypatch.setattr("lerobot_gloves.recording.experts.EXPERTS", {})
    monkeypatch.setattr(Simulation, "_max_episode_steps", property(lambda _: 8, lambda *_: None), raising=False)
    features = {
        "input_features": {"observation.state": PolicyFeature(FeatureType.STATE, (4,))},
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (4,))},
    }
    agent = save_policy(tmp_path / "agent", "gloves_expert_flow", **features)
    record(config(tmp_path / "data", task="reach-v3", num_episodes=1, image_size=32, agent=str(agent)))
    dataset = LeRobotDataset("me/metaworld", root=tmp_path / "data")
    assert set(dataset.features) == set(demonstrated.features)
    assert dataset.features["observation.image"]["shape"] == (32, 32, 3)
    with pytest.raises(ValueError, match="'metaworld' has no scripted expert: choose"):
        record(config(tmp_path / "more"))


def test_what_is_missing_is_one_clear_line(monkeypatch):
    with pytest.raises(ValueError, match=r"'metaworld' has no task 'push-v2': choose from assembly-v3, .*push-v3"):  # noqa: SIM117
        with environments(MetaworldEnv(), 1):  # LeRobot's default is of an older MetaWorld
            pass
    with pytest.raises(ValueError, match="'metaworld' is 2 tasks here: choose one"):  # noqa: SIM117
        with environments(config(None).env, 1):
            pass
    monkeypatch.delitem(sys.modules, "lerobot.envs.metaworld")
    monkeypatch.setitem(sys.modules, "metaworld", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'lerobot_policy_gloves\[metaworld\]'$"):  # noqa: SIM117
        with environments(MetaworldEnv(), 1):
            pass
