import shutil

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_gloves.recording import dataset, demonstrations, staging
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_gloves.tasks.slalom.environment import Slalom
from lerobot_gloves.tasks.slalom.scene import MODES


def record(config, folder, num_episodes, **options):
    folder.mkdir(exist_ok=True)
    options = {"num_episodes": num_episodes, "seed": 30002, "num_workers": 1} | options
    return list(demonstrations.record(config, folder, **options))


def assemble(config, folder, root, num_episodes):
    dataset.assemble(
        config, folder, root, repo_id="me/slalom", num_episodes=num_episodes, video=False, command="gloves record --x"
    )
    return LeRobotDataset("me/slalom", root=root)


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    assert record(SlalomEnv(), folder / "staging", 3) == [1, 2, 3]
    return folder / "staging", assemble(SlalomEnv(), folder / "staging", folder / "dataset", 3)


def test_recorded_episodes_are_what_the_environment_does(state):
    _, recorded = state
    columns = {key: np.stack(recorded.hf_dataset[key]) for key in recorded.features}
    assert (recorded.num_episodes, recorded.fps) == (3, 20)
    for index, task in enumerate(("0 0 2", "0 0 3", "0 1 0")):  # seed 30000 begins the corridors anew
        rows = columns["episode_index"].ravel() == index
        env = Slalom()
        observation, _ = env.reset(seed=30002 + index)
        assert env.task_description == task == recorded[int(rows.argmax())]["task"]
        assert (columns["mode"][rows] == MODES.index(task)).all()
        states = columns["observation.state"][rows]
        executed = np.diff(states[:, :2].astype(float), axis=0)  # jostled: not quite what the expert wanted
        assert np.median(np.abs(executed - columns["action"][rows][:-1])) < 0.004
        for step, action in enumerate(executed):
            assert np.allclose(states[step], observation["agent_pos"], atol=1e-5)
            for key in ("environment_state", "goal"):
                assert np.array_equal(columns[f"observation.{key}"][rows][step], observation[key])
            observation, _, terminated, truncated, _ = env.step(action)
            assert not terminated and not truncated
        assert states[-1, 3] > 0.35 - 0.012  # the step that crosses the line is the last


def test_labels_are_no_policy_input(state):
    _, recorded = state
    assert set(dataset_to_policy_features(recorded.meta.features)) == {
        "action",
        "observation.state",
        "observation.environment_state",
        "observation.goal",
    }
    assert recorded[0]["mode"].dtype == torch.int64 and recorded.meta.camera_keys == []
    assert recorded.meta.features["observation.goal"]["names"][2:5] == ["row_1_gap_0", "row_1_gap_1", "row_1_gap_2"]


def test_the_card_is_the_tasks_with_what_was_recorded(state):
    _, recorded = state
    card = (recorded.root / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0\n") and "# Slalom demonstrations" in card
    assert f"3 episodes, {recorded.num_frames} frames at 20 Hz" in card
    assert "| `observation.environment_state` | float32 | (12,) |" in card
    assert "```bash\ngloves record --x\n```" in card


def test_an_episode_is_the_same_whatever_was_recorded_before(state, tmp_path):
    folder, _ = state
    shutil.copy(folder / "episode_000000.npz", tmp_path)
    shutil.copy(folder / "episode_000002.npz", tmp_path)
    assert record(SlalomEnv(), tmp_path, 3) == [3]
    for key, values in staging.load(folder, 1).frames.items():
        assert np.array_equal(staging.load(tmp_path, 1).frames[key], values)


def test_what_a_killed_assembly_left_is_thrown_away(state, tmp_path):
    folder, recorded = state
    shutil.copytree(folder, tmp_path / "staging")
    (tmp_path / "staging" / "dataset" / "meta").mkdir(parents=True)
    (tmp_path / "staging" / "dataset" / "meta" / "info.json").write_text("{")
    again = assemble(SlalomEnv(), tmp_path / "staging", tmp_path / "dataset", 2)
    assert again.num_episodes == 2
    assert np.array_equal(again[5]["action"], recorded[5]["action"])


def test_pixel_recordings_hold_the_frames_and_not_the_pillars(tmp_path):
    config = SlalomEnv(obs_type="pixels_agent_pos", image_size=48, mode="0 0 0")
    record(config, tmp_path / "staging", 1)
    recorded = assemble(config, tmp_path / "staging", tmp_path / "dataset", 1)
    assert "observation.environment_state" not in recorded.features
    assert recorded.features["observation.images.front"]["dtype"] == "image"
    assert recorded.meta.robot_type == "panda"
    env = Slalom(obs_type="pixels_agent_pos", image_size=48)
    observation, _ = env.reset(options={"mode": "0 0 0"})
    states = np.stack(recorded.hf_dataset["observation.state"])
    staged = staging.load(tmp_path / "staging", 0).frames["observation.images.front"]
    for step in range(40):
        frame = (recorded[step]["observation.images.front"] * 255).round().byte().permute(1, 2, 0).numpy()
        assert np.array_equal(frame, staged[step])
        # Played again from float32 set-points, a pixel at an edge may differ.
        assert np.abs(frame.astype(int) - observation["pixels"]["front"]).mean() < 0.1
        observation, *_ = env.step(states[step + 1, :2].astype(float) - states[step, :2])
    assert np.abs(staged[0].astype(int) - staged[39]).mean() > 1


def test_a_failed_demonstration_is_dropped_and_played_anew(monkeypatch):
    class Clumsy:
        """Drives into the first pillar, except in its third episode."""

        episodes = 0

        def __init__(self, expert):
            self.expert = expert
            Clumsy.episodes += 1

        def reset(self, mode):
            self.expert.reset(mode)

        def act(self, observation):
            return self.expert.act(observation) if Clumsy.episodes == 3 else np.array([0.0, 0.01], np.float32)

        def disturb(self, action):
            return action

    original = SlalomEnv.make_expert
    monkeypatch.setattr(SlalomEnv, "make_expert", lambda self, rng: Clumsy(original(self, rng)))
    episode = demonstrations.demonstrate(SlalomEnv(), Slalom(), 30000)
    assert (episode.attempts, episode.task) == (3, "0 0 0")
    assert episode.frames["observation.state"][-1, 3] > 0.35 - 0.012
    monkeypatch.setattr(demonstrations, "MAX_ATTEMPTS", 2)
    with pytest.raises(ValueError, match=r"failed 2 times in the environment with seed 30000: .*episode_length"):
        demonstrations.demonstrate(SlalomEnv(), Slalom(), 30000)


@pytest.mark.slow
def test_several_processes_record_what_one_does(state, tmp_path):
    folder, _ = state
    assert record(SlalomEnv(), tmp_path, 3, num_workers=2)[-1] == 3
    for index in range(3):
        for key, values in staging.load(folder, index).frames.items():
            assert np.array_equal(staging.load(tmp_path, index).frames[key], values)
