"""The loop plays LeRobot's episodes, and says how they failed and what was edited in them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.envs import close_envs, make_env
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import eval_policy

from lerobot_gloves.benchmark.cell import Cell, split_gate
from lerobot_gloves.benchmark.play import run
from lerobot_gloves.benchmark.setup import Setup, load
from lerobot_gloves.evaluation.agent import WrappedAgent
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.evaluation.histogram import edge
from lerobot_gloves.evaluation.rollout import count_chunks, rollout
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_gloves.tasks.slalom.environment import Slalom
from tests.builders import SIZE, save_policy
from tests.straight import RIGHTMOST_SEED


def setup_of(agent: str, adapter: str, **options: Any) -> Setup:
    return Setup(env=SlalomEnv(), agent=agent, adapter=adapter, **{"episodes": 12, "batch_size": 8, **options})


@pytest.mark.parametrize(
    ("perturbation", "method"),
    [
        ("none", "none"),
        ("noised:sigma=0.005", "none"),
        ("laggy", "feeg:start=0.5"),
        ("noised", "feeg:start=0.5+gate"),
        ("noised:sigma=0.005+laggy:p=0.2", "feeg:start=0.5"),
    ],
)
def test_same_episodes_as_lerobot_eval(agent: str, adapter: str, perturbation: str, method: str) -> None:
    """Success and steps, over a whole batch and one of which a part is dropped."""
    editor, gate = split_gate(method)
    setup, cell = setup_of(agent, adapter), Cell(perturbation, editor, seed=0, gate=gate)
    ours = run(setup, cell)

    wrapped = load(setup, cell)
    identity = PolicyProcessorPipeline(steps=[])
    envs = make_env(setup.env, n_envs=setup.batch_size)
    env = envs["gloves_slalom"][0]
    stock = eval_policy(
        env,
        wrapped.policy,
        identity,
        identity,
        wrapped.prepare,
        wrapped.finish,
        n_episodes=12,
        start_seed=10000,
        return_episode_data=True,
    )
    close_envs(envs)

    assert [episode.seed for episode in ours] == [row["seed"] for row in stock["per_episode"]]
    assert [episode.success for episode in ours] == [row["success"] for row in stock["per_episode"]]
    # Every episode of LeRobot's data has a frame more than it has steps.
    frames = torch.bincount(stock["episodes"]["episode_index"])[:12]
    assert [episode.steps for episode in ours] == (frames - 1).tolist()
    assert len({episode.steps for episode in ours}) > 2, "episodes that all end together would prove little"


def test_episodes_say_how_they_ended(agent: str, adapter: str) -> None:
    """The agent steers along one corridor whatever is asked: it succeeds where that one is asked for."""
    episodes = run(setup_of(agent, adapter), Cell("none", "none", seed=0))
    assert [episode.seed for episode in episodes if episode.success] == [RIGHTMOST_SEED]
    assert {episode.failure for episode in episodes if not episode.success} == {"wrong_corridor"}
    assert all(episode.failure == "" for episode in episodes if episode.success)
    rough = run(setup_of(agent, adapter), Cell("noised:sigma=0.03", "none", seed=0))
    assert "collision" in {episode.failure for episode in rough}
    short = Setup(env=SlalomEnv(episode_length=5), agent=agent, episodes=2, batch_size=2)
    assert [(e.failure, e.steps) for e in run(short, Cell("none", "none", seed=0))] == [("timeout", 5)] * 2


def test_chunks_count_while_their_episode_runs(agent: str, adapter: str) -> None:
    """The agent plans every 4 steps; the longest episode of the batch must not count for the others."""
    ungated = run(setup_of(agent, adapter), Cell("none", "feeg:start=0.5,steps=7", seed=0))
    assert [episode.chunks for episode in ungated] == [-(-episode.steps // 4) for episode in ungated]
    assert all(episode.edited == episode.chunks and episode.distance > 0 for episode in ungated)
    assert all(episode.evaluations == pytest.approx(7) for episode in ungated)
    assert all(episode.milliseconds > 0 for episode in ungated)
    raw = run(setup_of(agent, adapter), Cell("none", "none", seed=0))
    assert {(episode.chunks, episode.edited, episode.distance) for episode in raw} == {(0, 0, 0.0)}


def test_gate_edits_what_it_turns_away(agent: str, adapter: str) -> None:
    gated = run(setup_of(agent, adapter), Cell("noised:sigma=0.005", "feeg:start=0.5", seed=0, gate=True))
    chunks, edited = sum(episode.chunks for episode in gated), sum(episode.edited for episode in gated)
    assert 0 < edited < chunks
    # One evaluation to score a chunk, ten to edit it.
    assert sum(episode.evaluations * episode.chunks for episode in gated) == pytest.approx(chunks + 10 * edited)


def test_a_seed_fixes_the_episodes_and_another_changes_them(agent: str, adapter: str) -> None:
    def outcome(seed: int) -> list[tuple[int, int, float]]:
        episodes = run(setup_of(agent, adapter), Cell("noised", "feeg", seed, gate=True))
        return [(episode.seed % 100, episode.steps, episode.distance) for episode in episodes]

    assert outcome(1) == outcome(1)
    assert outcome(1) != outcome(2)
    assert run(setup_of(agent, adapter, split="validation"), Cell("none", "none", seed=3))[0].seed == 20300


class Countdown(gym.Env):
    """Ends after `seed` steps, by termination if that is even; says nothing of failures."""

    observation_space = gym.spaces.Dict({"agent_pos": gym.spaces.Box(-1, 1, (2,), np.float32)})
    action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    _max_episode_steps = 6

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        self.seed, self.left = seed or 1, seed or 1
        return {"agent_pos": np.zeros(2, np.float32)}, {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        self.left -= 1
        over = self.left <= 0
        info = {"is_success": over and self.seed == 4}
        return (
            {"agent_pos": np.ones(2, np.float32)},
            0.0,
            over and self.seed % 2 == 0,
            over and self.seed % 2 == 1,
            info,
        )


class Idle:
    def reset(self) -> None: ...

    def select_action(self, batch: dict[str, Any]) -> torch.Tensor:
        assert batch["task"] == [""] * 4
        return torch.zeros(4, 2)


def test_an_environment_that_names_no_failures() -> None:
    """Neither task nor failure, in environments that begin anew by themselves."""
    env = gym.vector.SyncVectorEnv([Countdown] * 4, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
    episodes = rollout(env, WrappedAgent(Idle(), dict, lambda action: action), seeds=[2, 3, 4, 50])
    assert [episode.steps for episode in episodes] == [2, 3, 4, 6]
    assert [episode.success for episode in episodes] == [False, False, True, False]
    assert [episode.failure for episode in episodes] == ["failed", "timeout", "", "timeout"]


def test_scores_are_kept_by_what_became_of_their_chunk(agent: str, adapter: str) -> None:
    gated = run(setup_of(agent, adapter), Cell("noised:sigma=0.005", "feeg:start=0.5", seed=0, gate=True))
    for episode in gated:
        assert sum(episode.scores_edited.values()) == episode.edited
        assert sum(episode.scores_left.values()) == episode.chunks - episode.edited
    left = [int(number) for episode in gated for number in episode.scores_left]
    edited = [int(number) for episode in gated for number in episode.scores_edited]
    assert max(left) <= min(edited), "the gate's threshold lies between them"
    ungated = run(setup_of(agent, adapter), Cell("noised:sigma=0.005", "feeg:start=0.5", seed=0))
    assert not any(episode.scores_left or episode.scores_edited for episode in ungated)


def test_the_bins_of_an_episode_are_those_of_its_scores() -> None:
    episodes = [Episode(seed=0), Episode(seed=1)]
    for scores in ([3.0, 100.0], [3.1, 0.0]):
        correction = SimpleNamespace(
            edited=torch.tensor([False, scores[1] > 50]),
            distance=torch.zeros(2),
            evaluations=torch.ones(2),
            score=torch.tensor(scores),
            milliseconds=1.0,
        )
        count_chunks(episodes, np.array([True, True]), correction)
    ((number, count),) = episodes[0].scores_left.items()
    assert count == 2 and edge(int(number)) <= 3.0 < 3.1 < edge(int(number) + 1)
    assert list(episodes[1].scores_left) == ["0"]
    ((number, count),) = episodes[1].scores_edited.items()
    assert count == 1 and edge(int(number)) <= 100 < edge(int(number) + 1)


def test_a_watcher_sees_every_step_before_it_is_taken(agent: str) -> None:
    setup = Setup(env=SlalomEnv(episode_length=6), agent=agent, episodes=2, batch_size=2)
    wrapped = load(setup, Cell("none", "none", seed=0))
    seen: list[np.ndarray] = []
    with environments(setup.env, 2) as env:
        rollout(env, wrapped, [10000, 10001], lambda observation, _: seen.append(observation["agent_pos"]))
    assert len(seen) == 6
    first, _ = Slalom().reset(seed=10000)
    assert np.array_equal(seen[0][0], first["agent_pos"])
    assert not np.array_equal(seen[0], seen[1])


def test_our_tasks_draw_only_what_is_looked_at(tmp_path, monkeypatch) -> None:
    """The agent plans every 4 steps; what it is shown in between it does not read."""
    pixels = "pixels_agent_pos"
    agent = str(save_policy(tmp_path / "agent", "gloves_flow_policy", pixels))
    adapter = str(save_policy(tmp_path / "adapter", "gloves_expert_flow", pixels))
    env = SlalomEnv(obs_type=pixels, image_size=SIZE, episode_length=12)
    setup = Setup(env=env, agent=agent, adapter=adapter, episodes=2, batch_size=2)
    cell, drawn, draw = Cell("none", "feeg:start=0.5", seed=0), [], Slalom._draw
    monkeypatch.setattr(Slalom, "_draw", lambda env, camera: drawn.append(camera) or draw(env, camera))
    episodes = run(setup, cell)
    assert {episode.chunks for episode in episodes} == {3}
    # Before each chunk, and behind the last step, where another would begin.
    assert len(drawn) == 2 * 4
    monkeypatch.setattr("lerobot_gloves.evaluation.rollout.draw_only", lambda *_: None)
    drawn.clear()
    everything = run(setup, cell)
    assert len(drawn) == 2 * 13
    assert [replace(e, milliseconds=0.0) for e in everything] == [replace(e, milliseconds=0.0) for e in episodes]
