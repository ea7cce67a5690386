"""Plays a task's scripted expert until enough demonstrations are staged."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION

from lerobot_gloves.evaluation.agent import TASK_ATTRIBUTES
from lerobot_gloves.evaluation.environments import every_task, refuse_fast
from lerobot_gloves.evaluation.seeds import ALL
from lerobot_gloves.recording import staging
from lerobot_gloves.recording.experts import Recordable, expert_of
from lerobot_gloves.recording.observations import single
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.recording.workers import stage_all

MAX_ATTEMPTS = 50
MODE = "mode"
"""Key of a frame's label: the place of its task string among the task's modes. LeRobot hands no policy this key."""


def record(
    env_config: EnvConfig,
    folder: Path,
    *,
    num_episodes: int,
    seed: int,
    num_workers: int,
    image_size: int | None = None,
    fast_rendering: bool = False,
) -> Iterator[int]:
    """Stage the episodes 0 to `num_episodes` - 1 that are not there yet.

    Episode i depends on the configuration and on seed + i alone, so it is the same whoever records it and whatever
    was recorded before.

    Args:
        env_config: The task.
        folder: The staging folder.
        num_episodes: How many episodes there shall be.
        seed: Seed of episode 0.
        num_workers: Processes that record side by side.
        image_size: Height and width of the images that are kept, in pixels; None for those that are observed.
        fast_rendering: Whether MuJoCo draws without multisampling and with coarser shadows.

    Yields:
        How many episodes there are, whenever that has changed.
    """
    parts = [range(index, index + 1) for index in range(num_episodes)]
    stage = partial(_stage, env_config, folder, seed, image_size, fast_rendering)
    yield from stage_all(stage, folder, parts, num_workers)


def _stage(
    env_config: EnvConfig,
    folder: Path,
    seed: int,
    image_size: int | None,
    fast_rendering: bool,
    parts: Sequence[range],
) -> Iterator[None]:
    with simulations(env_config, fast_rendering) as envs:
        for part in parts:
            for index in part:
                env = envs[(seed + index) % len(envs)]
                staging.save(folder, index, demonstrate(env_config, env, seed + index, image_size))
            yield


@contextmanager
def simulations(env_config: EnvConfig, fast_rendering: bool = False) -> Iterator[list[gym.Env]]:
    """Where a task is demonstrated; one for each of the tasks if a stock environment is several."""
    if isinstance(env_config, Recordable):
        refuse_fast(env_config, fast_rendering)
        env: gym.Env = gym.make(env_config.gym_id, disable_env_checker=True, **env_config.demonstration_kwargs)
        yield [env]
        env.close()
    else:
        with every_task(env_config, 1, fast_rendering=fast_rendering) as batches:
            yield [batch.envs[0] for batch in batches]


def demonstrate(env_config: EnvConfig, env: gym.Env, seed: int, image_size: int | None = None) -> StagedEpisode:
    """Play episodes until one succeeds.

    An expert of our tasks plays all of them with one seed, each time with fresh draws. One of a stock environment may
    draw nothing and would fail again, so each further try of it has another seed, beyond all that anything else uses.

    Args:
        env_config: The task.
        env: Its environment.
        seed: Seed of the environment.
        image_size: Height and width of the images that are kept, in pixels; None for those that are observed.

    Raises:
        ValueError: If `MAX_ATTEMPTS` episodes fail.
    """
    make_expert = expert_of(env_config, env)
    own = isinstance(env_config, Recordable)
    for attempt in range(MAX_ATTEMPTS):
        expert = make_expert(np.random.default_rng([seed, attempt]))
        observation, info = env.reset(seed=seed if own else seed + ALL * attempt)
        task = next((str(env.get_wrapper_attr(name)) for name in TASK_ATTRIBUTES if env.has_wrapper_attr(name)), "")
        expert.reset(task)
        steps: list[dict[str, np.ndarray]] = []
        over = False
        while not over:
            action = expert.act(observation)
            steps.append({**single(env_config, observation, image_size), ACTION: action})
            observation, _, terminated, truncated, info = env.step(expert.disturb(action))
            over = terminated or truncated
        if info["is_success"]:
            frames = {key: np.stack([step[key] for step in steps]) for key in steps[0]}
            if isinstance(env_config, Recordable):
                frames[MODE] = np.full((len(steps), 1), env_config.modes.index(task), dtype=np.int64)
            return StagedEpisode(frames=frames, task=task, attempts=attempt + 1)
    raise ValueError(
        f"the expert failed {MAX_ATTEMPTS} times in the environment with seed {seed}: does an episode end too early "
        "for it (--env.episode_length)?"
    )
