"""Plays a task's scripted expert until enough demonstrations are staged."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Protocol, cast, runtime_checkable

import gymnasium as gym
import numpy as np
from lerobot.configs import PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION

from lerobot_gloves.recording import staging
from lerobot_gloves.recording.observations import single
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.recording.workers import stage_all

MAX_ATTEMPTS = 50
MODE = "mode"
"""Key of a frame's label: the place of its task string among the task's modes. LeRobot hands no policy this key."""


class Expert(Protocol):
    """Whoever demonstrates a task."""

    def reset(self, mode: str) -> None:
        """Begin an episode with this task string."""

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The action for an observation of the Gymnasium environment; this is what is recorded."""

    def disturb(self, action: np.ndarray) -> np.ndarray:
        """What the environment executes instead, if the robot is jostled while the expert demonstrates."""


@runtime_checkable
class Recordable(Protocol):
    """What an `EnvConfig` offers when its task has a scripted expert to be recorded; an agent needs none of it."""

    modes: ClassVar[tuple[str, ...]]
    feature_names: ClassVar[dict[str, list[str]]]
    features: dict[str, PolicyFeature]
    features_map: dict[str, str]
    fps: int

    @property
    def type(self) -> str:
        """The `--env.type` of the task."""

    @property
    def gym_id(self) -> str:
        """Name of the Gymnasium environment."""

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Its arguments."""

    @property
    def demonstration_kwargs(self) -> dict[str, Any]:
        """Its arguments where the expert demonstrates; a demonstration may be part of an episode."""

    def make_expert(self, rng: np.random.Generator) -> Expert:
        """An expert that takes all its draws from `rng`."""


def check_recordable(env_config: EnvConfig) -> Recordable:
    """Refuse a task that has no scripted expert.

    Raises:
        ValueError: If it has none; names those that have.
    """
    if isinstance(env_config, Recordable):
        return env_config
    choices = sorted(name for name, cls in EnvConfig.get_known_choices().items() if hasattr(cls, "make_expert"))
    raise ValueError(
        f"env.type {env_config.type!r} has no scripted expert: choose one of {', '.join(choices)}, or record a policy "
        "by --agent"
    )


def record(env_config: Recordable, folder: Path, *, num_episodes: int, seed: int, num_workers: int) -> Iterator[int]:
    """Stage the episodes 0 to `num_episodes` - 1 that are not there yet.

    Episode i depends on the configuration and on seed + i alone, so it is the same whoever records it and whatever
    was recorded before.

    Args:
        env_config: The task.
        folder: The staging folder.
        num_episodes: How many episodes there shall be.
        seed: Seed of episode 0.
        num_workers: Processes that record side by side.

    Yields:
        How many episodes there are, whenever that has changed.
    """
    parts = [range(index, index + 1) for index in range(num_episodes)]
    yield from stage_all(partial(_stage, env_config, folder, seed), folder, parts, num_workers)


def _stage(env_config: Recordable, folder: Path, seed: int, parts: Sequence[range]) -> Iterator[None]:
    env = gym.make(env_config.gym_id, disable_env_checker=True, **env_config.demonstration_kwargs)
    for part in parts:
        for index in part:
            staging.save(folder, index, demonstrate(env_config, env, seed + index))
        yield
    env.close()


def demonstrate(env_config: Recordable, env: gym.Env, seed: int) -> StagedEpisode:
    """Play episodes with one seed, each time with fresh draws of the expert, until one succeeds.

    Args:
        env_config: The task.
        env: Its environment.
        seed: Seed of the environment.

    Raises:
        ValueError: If `MAX_ATTEMPTS` episodes fail.
    """
    for attempt in range(MAX_ATTEMPTS):
        expert = env_config.make_expert(np.random.default_rng([seed, attempt]))
        observation, info = env.reset(seed=seed)
        task = cast(str, env.get_wrapper_attr("task_description"))
        expert.reset(task)
        steps: list[dict[str, np.ndarray]] = []
        over = False
        while not over:
            action = expert.act(observation)
            steps.append({**single(cast(EnvConfig, env_config), observation), ACTION: action})
            observation, _, terminated, truncated, info = env.step(expert.disturb(action))
            over = terminated or truncated
        if info["is_success"]:
            frames = {key: np.stack([step[key] for step in steps]) for key in steps[0]}
            frames[MODE] = np.full((len(steps), 1), env_config.modes.index(task), dtype=np.int64)
            return StagedEpisode(frames=frames, task=task, attempts=attempt + 1)
    raise ValueError(
        f"the expert failed {MAX_ATTEMPTS} times in the environment with seed {seed}: does an episode end too early "
        "for it (--env.episode_length)?"
    )
