"""A batch of a task's environments, as LeRobot makes them."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium as gym
from lerobot.envs import EnvConfig, close_envs, make_env


@contextmanager
def environments(config: EnvConfig, batch_size: int) -> Iterator[gym.vector.SyncVectorEnv]:
    """A batch of one task's environments, all in this process.

    Raises:
        ValueError: If they are several tasks, or run in processes of their own.
    """
    # The last batch may refer to itself, and hold what Python does not see the size of: a simulator's memory.
    gc.collect()
    envs = make_env(config, n_envs=batch_size, use_async_envs=False)
    try:
        found = [env for suite in envs.values() for env in suite.values()]
        if len(found) != 1 or not isinstance(found[0], gym.vector.SyncVectorEnv):
            raise ValueError(f"env.type {config.type!r} is {len(found)} tasks, or not run in this process: choose one")
        yield found[0]
    finally:
        close_envs(envs)
