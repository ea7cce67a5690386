"""Batched episodes of a policy, with what LeRobot's own loop drops: how an episode failed, and what was edited."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.envs import preprocess_observation
from lerobot.envs.utils import NEW_ROLLOUT_OPTION
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_gloves.evaluation import histogram
from lerobot_gloves.evaluation.histogram import Histogram


@dataclass
class Episode:
    """One episode and what the wrapper did in it.

    Attributes:
        seed: Seed of its environment.
        success: Whether it succeeded.
        failure: Why it did not, in the environment's words; "" for a success.
        steps: Control steps that it took.
        chunks: Proposals that an adapter saw.
        edited: How many of them it edited.
        distance: Their mean distance between proposed and executed actions, 0 where nothing was edited, in the
            adapter's normalised units.
        milliseconds: Mean time of the adapter for one of them, the batch's time shared out.
        evaluations: Mean network evaluations of the adapter for one of them.
        scores_left: Histogram of the scores of those that were left as they are; empty if the method asks for none.
        scores_edited: The same of those that were edited.
    """

    seed: int
    success: bool = False
    failure: str = ""
    steps: int = 0
    chunks: int = 0
    edited: int = 0
    distance: float = 0.0
    milliseconds: float = 0.0
    evaluations: float = 0.0
    scores_left: Histogram = field(default_factory=dict)
    scores_edited: Histogram = field(default_factory=dict)

    def note(
        self, edited: bool, distance: float, milliseconds: float, evaluations: float, score: float | None = None
    ) -> None:
        """Count one more chunk."""
        self.chunks += 1
        self.edited += edited
        self.distance += (distance - self.distance) / self.chunks
        self.milliseconds += (milliseconds - self.milliseconds) / self.chunks
        self.evaluations += (evaluations - self.evaluations) / self.chunks
        if score is not None:
            histogram.add(self.scores_edited if edited else self.scores_left, score)


def rollout(
    env: gym.vector.SyncVectorEnv,
    policy: PreTrainedPolicy,
    prepare: Callable[[dict[str, Any]], dict[str, Any]],
    finish: Callable[[Tensor], Tensor],
    seeds: Sequence[int],
    watch: Callable[[Mapping[str, Any], np.ndarray], None] | None = None,
) -> list[Episode]:
    """Play one episode in each environment; the same episodes as LeRobot's `rollout`.

    Args:
        env: B environments.
        policy: Any policy. The wrapper, known by its attributes `running` and `correction`, is told which episodes
            still run, and its chunks are counted.
        prepare: From observations under LeRobot's keys to the policy's input.
        finish: From the policy's actions (B, A) to the environment's.
        seeds: B seeds of the environments.
        watch: Called once a step, when the policy has acted and before the environments do, with their observations
            and with which episodes still run, bool (B,).
    """
    policy.reset()
    observation, _ = env.reset(seed=list(seeds), options={NEW_ROLLOUT_OPTION: True})
    episodes = [Episode(seed) for seed in seeds]
    running = np.ones(env.num_envs, dtype=bool)
    limit = env.call("_max_episode_steps")[0]
    for step in range(1, limit + 1):
        if hasattr(policy, "running"):
            policy.running = torch.from_numpy(running.copy())
        action = act(env, policy, prepare, finish, observation)
        count_chunks(episodes, running, getattr(policy, "correction", None))
        if watch is not None:
            watch(observation, running)
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


def act(
    env: gym.vector.SyncVectorEnv,
    policy: PreTrainedPolicy,
    prepare: Callable[[dict[str, Any]], dict[str, Any]],
    finish: Callable[[Tensor], Tensor],
    observation: dict[str, Any],
) -> Tensor:
    """The policy's actions (B, A) on what B environments show; see `rollout`."""
    batch = prepare({**preprocess_observation(observation), "task": tasks(env)})
    with torch.inference_mode():
        return finish(policy.select_action(batch))


def tasks(env: gym.vector.SyncVectorEnv) -> list[str]:
    """The task string of each environment, from the attribute that LeRobot prefers."""
    for name in ("task_description", "task"):
        try:
            return list(env.call(name))
        except (AttributeError, NotImplementedError):
            continue
    return [""] * env.num_envs


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
