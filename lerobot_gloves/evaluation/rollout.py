"""Batched episodes of a policy, with what LeRobot's own loop drops: how an episode failed, and what was edited."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.envs.utils import NEW_ROLLOUT_OPTION

from lerobot_gloves.evaluation.agent import WrappedAgent
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.evaluation.rendering import draw_only


def rollout(
    env: gym.vector.SyncVectorEnv,
    agent: WrappedAgent,
    seeds: Sequence[int],
    watch: Callable[[Mapping[str, Any], np.ndarray], None] | None = None,
) -> list[Episode]:
    """Play one episode in each environment; the same episodes as LeRobot's `rollout`.

    Args:
        env: B environments.
        agent: Any policy. The wrapper, known by its attributes `running`, `correction` and `unread`, is told which
            episodes still run and between what actions must lie, its chunks are counted, and what it does not read is
            not drawn.
        seeds: B seeds of the environments.
        watch: Called once a step, when the policy has acted and before the environments do, with their observations
            and with which episodes still run, bool (B,).
    """
    policy = agent.policy
    policy.reset()
    space = env.single_action_space
    if agent.direct and isinstance(space, gym.spaces.Box) and hasattr(policy, "bound_actions"):
        policy.bound_actions(torch.from_numpy(space.low), torch.from_numpy(space.high))
    draw_only(env, np.ones(env.num_envs, dtype=bool))
    observation, _ = env.reset(seed=list(seeds), options={NEW_ROLLOUT_OPTION: True})
    episodes = [Episode(seed) for seed in seeds]
    running = np.ones(env.num_envs, dtype=bool)
    limit = env.call("_max_episode_steps")[0]
    for step in range(1, limit + 1):
        if hasattr(policy, "running"):
            policy.running = torch.from_numpy(running.copy())
        action = agent.act(env, observation)
        count_chunks(episodes, running, getattr(policy, "correction", None))
        if watch is not None:
            watch(observation, running)
        draw_only(env, running & (getattr(policy, "unread", 0) == 0))
        observation, _, terminated, truncated, info = env.step(action.cpu().numpy())
        over = terminated | truncated | (step == limit)
        for row in running.nonzero()[0]:
            episode = episodes[row]
            episode.steps = step
            episode.success = episode.success or bool(fact(info, "is_success", row, False))
            if over[row] and not episode.success:
                unnamed = "failed" if terminated[row] else "timeout"
                episode.failure = str(fact(info, "failure", row, "")) or unnamed
        running &= ~over
        if not running.any():
            break
    return episodes


def fact(info: Mapping[str, Any], key: str, row: int, default: Any) -> Any:
    """What a vector environment's info says of one environment at this step.

    For one whose episode has just ended it lies in `final_info`: the rest may be of the next episode already.
    """
    for source in (info.get("final_info", {}), info):
        if key in source and source.get(f"_{key}", np.ones(row + 1, dtype=bool))[row]:
            return source[key][row]
    return default


def count_chunks(episodes: Sequence[Episode], running: np.ndarray, correction: Any) -> None:
    """Note what became of the chunks of those episodes that still run."""
    if correction is None:
        return
    for row in running.nonzero()[0]:
        episodes[row].note(
            bool(correction.edited[row]),
            float(correction.distance[row]),
            correction.milliseconds,
            float(correction.evaluations[row]),
            None if correction.score is None else float(correction.score[row]),
        )
