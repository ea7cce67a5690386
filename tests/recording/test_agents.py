"""What is recorded of an agent is what LeRobot's own loop sees it do, and LeRobot's own tools merge it."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset, merge_datasets
from lerobot.policies import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import rollout

from lerobot_gloves.evaluation.agent import WrappedAgent
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.perturbations import Noised
from lerobot_gloves.recording import agents, dataset, demonstrations, staging
from lerobot_gloves.recording.agents import Agent
from lerobot_gloves.recording.sources import source_of
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_gloves.tasks.slalom.scene import MODES
from tests.builders import SIZE, save_policy, slalom, wrap
from tests.straight import save

BATCH, SEED, T = 8, 40000, 4
"""Of these eight environments, the last asks for the corridor that the agent always takes."""
NOISED = "noised:sigma=0.005"


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """Steers along a straight line whatever is asked, four actions a chunk."""
    return save(tmp_path_factory.mktemp("agent"), "gloves_flow_policy", std=0.002)


def play(checkpoint, perturbation, batch=BATCH, seed=SEED, env_config=None):
    env_config, agent = env_config or SlalomEnv(), Agent(str(checkpoint), perturbation, batch)
    with environments(env_config, batch) as env:
        return agents.play(env_config, agent, env, seed)


@pytest.fixture(scope="module")
def unperturbed(checkpoint):
    return play(checkpoint, "none")


@pytest.fixture(scope="module")
def noised(checkpoint):
    return play(checkpoint, NOISED)


def in_lerobots_loop(checkpoint, perturbation):
    """The same episodes in LeRobot's own loop: what was executed and observed, and when each episode ended."""
    policy = wrap(checkpoint, perturbation=perturbation, seed=SEED, agent_overrides=[f"--seed={SEED}"])
    identity = PolicyProcessorPipeline(steps=[])
    pipelines = make_pre_post_processors(policy.config, str(policy.config.pretrained_path))
    with slalom(batch=BATCH, episode_length=300) as env:
        seeds = [SEED + i for i in range(BATCH)]
        return rollout(env, policy, identity, identity, *pipelines, seeds=seeds, return_observations=True)


@pytest.mark.parametrize("perturbation", ["none", NOISED])
def test_proposals_and_observations_are_those_of_lerobots_loop(checkpoint, perturbation, request):
    recorded = request.getfixturevalue("unperturbed" if perturbation == "none" else "noised")
    seen = in_lerobots_loop(checkpoint, None if perturbation == "none" else Noised(sigma=0.005))
    tails = 0
    for row, episode in enumerate(recorded):
        steps = int(seen["done"][row].int().argmax()) + 1
        actions = episode.frames["action"]
        assert actions.shape == (-(-steps // T), T, 2), "whole blocks, as many as there were queries"
        flat, executed = actions.reshape(-1, 2), seen["action"][row].numpy()
        both = min(len(flat), len(executed))
        assert np.array_equal(flat[:both], executed[:both])
        tails += both - steps  # where others of the batch went on, so did the chunk that was cut off
        for key in ("observation.state", "observation.goal", "observation.environment_state"):
            assert np.array_equal(episode.frames[key], seen["observation"][key][row, : T * len(actions) : T].numpy())
        assert (episode.failure == "") == bool(seen["success"][row].any())
    assert tails > 0


def test_failures_are_kept(unperturbed):
    assert [episode.failure for episode in unperturbed] == ["wrong_corridor"] * 7 + [""]
    assert {episode.attempts for episode in unperturbed} == {1}


def test_labels(unperturbed, noised):
    for source, episodes in (("none", unperturbed), ("noised", noised)):
        for index, episode in enumerate(episodes):
            assert source_of(episode.task) == (source, T)
            assert episode.task.endswith(", succeeded") == (episode.failure == "")
            assert (episode.frames["mode"] == (SEED + index) % len(MODES)).all()
            assert episode.frames["mode"].shape == (len(episode.frames["action"]), 1)


def test_the_perturbation_is_applied(unperturbed, noised):
    """The first chunk of each episode differs by exactly the noise that the library draws for it."""
    perturbation = Noised(sigma=0.005)
    perturbation.reset(BATCH, SEED)
    expected = perturbation(torch.zeros(BATCH, T, 2)).numpy()
    found = [
        after.frames["action"][0] - before.frames["action"][0]
        for before, after in zip(unperturbed, noised, strict=True)
    ]
    assert np.allclose(found, expected, atol=1e-7)
    assert 0.003 < expected.std() < 0.007


def test_a_laggy_agent_repeats_whole_blocks(checkpoint):
    (episode,) = play(checkpoint, "laggy:p=1.0", batch=1)
    actions = episode.frames["action"]
    assert len(actions) > 3 and (actions == actions[0]).all()
    assert len(np.unique(episode.frames["observation.state"], axis=0)) == len(actions)


def record(checkpoint, folder, num_episodes, perturbation=NOISED, batch=3, **options):
    folder.mkdir(exist_ok=True)
    agent = Agent(str(checkpoint), perturbation, batch)
    options = {"num_episodes": num_episodes, "seed": SEED, "num_workers": 1} | options
    return list(agents.record(SlalomEnv(episode_length=30), agent, folder, **options))


def same(one, other, index):
    mine, theirs = staging.load(one, index), staging.load(other, index)
    assert (mine.task, mine.failure) == (theirs.task, theirs.failure)
    return all(np.array_equal(values, theirs.frames[key]) for key, values in mine.frames.items())


@pytest.fixture(scope="module")
def staged(checkpoint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("staged")
    assert record(checkpoint, folder, 7) == [3, 6, 7]
    return folder


def test_a_batch_is_the_same_whatever_was_recorded_before(checkpoint, staged, tmp_path):
    """Of the second batch one episode is missing; the third is asked for more than the first time."""
    for index in (0, 1, 2, 3, 5, 6):
        staging.save(tmp_path, index, staging.load(staged, index))
    assert record(checkpoint, tmp_path, 8) == [7, 8]
    assert all(same(staged, tmp_path, index) for index in range(7))
    assert staging.load(tmp_path, 7).frames["mode"][0] == (SEED + 7) % len(MODES)


def test_another_seed_is_another_recording(checkpoint, staged, tmp_path):
    """Of the same corridors, since these come again."""
    record(checkpoint, tmp_path, 3, seed=SEED + len(MODES))
    assert staging.load(tmp_path, 0).frames["mode"][0] == staging.load(staged, 0).frames["mode"][0]
    assert not same(staged, tmp_path, 0)


@pytest.mark.slow
def test_several_processes_record_what_one_does(checkpoint, staged, tmp_path):
    assert record(checkpoint, tmp_path, 7, num_workers=2)[-1] == 7
    assert all(same(staged, tmp_path, index) for index in range(7))


def assemble(folder, root, num_episodes, agent=None):
    config = SlalomEnv(episode_length=30)
    name = f"me/{root.name}"
    options = {"num_episodes": num_episodes, "video": False, "command": "gloves record --x", "agent": agent}
    dataset.assemble(config, folder, root, repo_id=name, **options)
    return LeRobotDataset(name, root=root)


@pytest.fixture(scope="module")
def recorded(checkpoint, staged, tmp_path_factory):
    return assemble(staged, tmp_path_factory.mktemp("noised") / "noised", 7, Agent(str(checkpoint), NOISED, 3))


def columns(recorded, rows=slice(None)):
    return {key: np.stack(recorded.hf_dataset[key])[rows] for key in recorded.features}


def test_a_block_is_adjacent_rows_with_the_observation_of_its_query(staged, recorded):
    found = columns(recorded)
    for index in range(7):
        episode = staging.load(staged, index)
        rows = found["episode_index"].ravel() == index
        assert np.array_equal(found["action"][rows], episode.frames["action"].reshape(-1, 2))
        assert found["frame_index"][rows].ravel().tolist() == list(range(T * len(episode.frames["action"])))
        for key in ("observation.state", "observation.goal", "mode"):
            repeated = np.repeat(episode.frames[key], T, axis=0)
            assert np.array_equal(found[key][rows].reshape(repeated.shape), repeated)
    assert {recorded[i]["task"] for i in range(len(recorded))} == {"agent: noised, chunks of 4"}


def test_the_card_says_what_the_rows_mean_and_how_it_went(checkpoint, recorded):
    card = (recorded.root / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0\n") and "# An agent's proposals" in card
    assert f"Task: `gloves_slalom`. Agent: `{checkpoint}`. Perturbation: `noised:sigma=0.005`." in card
    assert "Episodes that succeeded: 0 of 7 (failed: timeout 7)." in card


def test_lerobot_merges_agents_and_experts(checkpoint, staged, recorded, tmp_path):
    for name in ("expert", "none"):
        (tmp_path / f"{name}.staging").mkdir()
    list(demonstrations.record(SlalomEnv(), tmp_path / "expert.staging", num_episodes=2, seed=30000, num_workers=1))
    expert = assemble(tmp_path / "expert.staging", tmp_path / "expert", 2)
    record(checkpoint, tmp_path / "none.staging", 2, perturbation="none", batch=2)
    none = assemble(tmp_path / "none.staging", tmp_path / "none", 2, Agent(str(checkpoint), "none", 2))
    merged = merge_datasets([expert, recorded, none], "me/both", tmp_path / "both")
    parts = {"expert": expert, "noised": recorded, "none": none}
    assert merged.num_episodes == 2 + 7 + 2 and len(merged) == sum(map(len, parts.values()))
    tasks = [merged.meta.tasks.index[int(index)] for index in np.stack(merged.hf_dataset["task_index"])]
    sources = np.array([source_of(task)[0] for task in tasks])
    for source, part in parts.items():
        mine, theirs = columns(merged, sources == source), columns(part)
        for key in ("action", "observation.state", "observation.environment_state", "mode", "frame_index"):
            assert np.array_equal(mine[key], theirs[key])
    lengths = {source_of(task)[1] for task, source in zip(tasks, sources, strict=True) if source != "expert"}
    assert lengths == {T}


def test_pixels_are_recorded_once_a_query_and_repeated(tmp_path_factory):
    checkpoint = save_policy(tmp_path_factory.mktemp("seeing"), "gloves_flow_policy", "pixels_agent_pos")
    config = SlalomEnv(obs_type="pixels_agent_pos", image_size=SIZE, episode_length=6)
    (episode,) = play(checkpoint, "none", batch=1, env_config=config)
    images = episode.frames["observation.images.front"]
    assert images.shape == (2, SIZE, SIZE, 3) and images.dtype == np.uint8
    rows = list(episode.rows())
    assert len(rows) == 2 * T
    assert all(np.array_equal(rows[i]["observation.images.front"], images[i // T]) for i in range(2 * T))
    assert "observation.environment_state" not in rows[0]
    assert images[0].std() > 1


def test_proposals_of_several_lengths_are_refused(monkeypatch):
    class Wavering:
        config = SimpleNamespace(device="cpu", use_amp=False)
        perturbation = None
        step = 0

        def reset(self):
            pass

        def select_action(self, batch):
            if self.step % 2 == 0:
                self.perturbation(torch.zeros(1, 2 + self.step, 2))
            self.step += 1
            return torch.zeros(1, 2)

    monkeypatch.setattr(
        agents, "load_agent", lambda *_: WrappedAgent(Wavering(), lambda seen: seen, lambda action: action)
    )
    with pytest.raises(ValueError, match="proposals of somebody have 2 and 4 actions"):
        play("somebody", "none", batch=1, env_config=SlalomEnv(episode_length=3))
