import numpy as np
import pytest

from lerobot_gloves.recording import staging
from lerobot_gloves.recording.staging import StagedEpisode


def test_an_episode_comes_back_as_it_was_saved(tmp_path):
    frames = {
        "observation.state": np.random.default_rng(0).standard_normal((5, 4)).astype(np.float32),
        "observation.images.front": np.arange(5 * 8 * 8 * 3, dtype=np.uint8).reshape(5, 8, 8, 3),
        "mode": np.full((5, 1), 23),
    }
    staging.save(tmp_path, 7, StagedEpisode(frames=frames, task="1 2 3", attempts=2))
    assert staging.staged(tmp_path) == {7}
    loaded = staging.load(tmp_path, 7)
    assert (loaded.task, loaded.attempts, loaded.frames.keys()) == ("1 2 3", 2, frames.keys())
    for key, values in frames.items():
        assert loaded.frames[key].dtype == values.dtype
        assert np.array_equal(loaded.frames[key], values)


def test_an_agents_episode_says_how_it_failed_and_has_a_row_an_action(tmp_path):
    actions = np.arange(12.0).reshape(2, 3, 2)
    frames = {"action": actions, "observation.state": np.array([[1.0], [2.0]])}
    staging.save(tmp_path, 0, StagedEpisode(frames=frames, task="agent: none, chunks of 3", failure="collision"))
    loaded = staging.load(tmp_path, 0)
    assert (loaded.failure, loaded.attempts) == ("collision", 1)
    rows = list(loaded.rows())
    assert [row["action"].tolist() for row in rows] == actions.reshape(6, 2).tolist()
    assert [float(row["observation.state"][0]) for row in rows] == [1, 1, 1, 2, 2, 2]


def test_a_demonstration_has_a_row_a_step():
    frames = {"action": np.arange(6.0).reshape(3, 2), "mode": np.array([[5], [5], [5]])}
    rows = list(StagedEpisode(frames=frames, task="").rows())
    assert [(row["action"].tolist(), int(row["mode"][0])) for row in rows] == [([0, 1], 5), ([2, 3], 5), ([4, 5], 5)]


def test_an_episode_whose_writing_was_cut_off_does_not_count(tmp_path, monkeypatch):
    def killed(file, **arrays):
        file.write(b"PK half an archive")
        file.flush()
        assert any(tmp_path.iterdir()) and staging.staged(tmp_path) == set()
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", killed)
    with pytest.raises(KeyboardInterrupt):
        staging.save(tmp_path, 0, StagedEpisode(frames={"action": np.zeros((3, 2))}, task="", attempts=1))
    assert not any(tmp_path.iterdir())


def test_only_episodes_of_the_same_settings_are_taken_up(tmp_path):
    folder = staging.staging_folder(tmp_path / "slalom")
    assert folder == tmp_path / "slalom.staging"
    settings = {"env.type": "gloves_slalom", "obs_type": "state", "mode": None, "seed": 30000}
    staging.open_staging(folder, settings | {"seed": 7})  # nothing came of it
    staging.open_staging(folder, settings)
    staging.save(folder, 0, StagedEpisode(frames={"action": np.zeros((3, 2))}, task=""))
    staging.open_staging(folder, settings)
    with pytest.raises(ValueError, match=r"slalom.staging holds episodes recorded with obs_type=state, seed=30000"):
        staging.open_staging(folder, settings | {"obs_type": "pixels_agent_pos", "seed": 30001})
