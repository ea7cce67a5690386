"""A batch of a task's environments, as LeRobot makes them."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium as gym
from lerobot.envs import EnvConfig, close_envs, make_env

from lerobot_gloves.evaluation.agent import quiet

EXTRAS = ("metaworld", "pusht")
"""Those of LeRobot's own environments that an extra of ours installs, which has the name of their `--env.type`."""


@contextmanager
def environments(config: EnvConfig, batch_size: int) -> Iterator[gym.vector.SyncVectorEnv]:
    """A batch of one task's environments, all in this process.

    Raises:
        ValueError: If they are several tasks, or run in processes of their own, or there is no such task.
        ModuleNotFoundError: If the simulator is not installed.
    """
    with every_task(config, batch_size) as found:
        if len(found) != 1:
            raise ValueError(f"env.type {config.type!r} is {len(found)} tasks here: choose one by --env.task")
        yield found[0]


@contextmanager
def every_task(config: EnvConfig, batch_size: int) -> Iterator[list[gym.vector.SyncVectorEnv]]:
    """The same for each of the tasks that an environment is, such as those of a benchmark's suite."""
    # The last batch may refer to itself, and hold what Python does not see the size of: a simulator's memory.
    gc.collect()
    envs = _made(config, batch_size)
    try:
        found = [env for suite in envs.values() for env in suite.values()]
        here = [env for env in found if isinstance(env, gym.vector.SyncVectorEnv)]
        if len(here) < len(found):
            raise ValueError(f"env.type {config.type!r} does not run in this process")
        yield here
    finally:
        close_envs(envs)


def _made(config: EnvConfig, batch_size: int) -> dict[str, dict[int, gym.vector.VectorEnv]]:
    """LeRobot's environments; what is missing for them in one line, where LeRobot lets Python say it."""
    try:
        with quiet():
            return make_env(config, n_envs=batch_size, use_async_envs=False)
    except ModuleNotFoundError as error:
        if config.type not in EXTRAS:
            raise
        raise ModuleNotFoundError(
            f"env.type {config.type!r} is not installed ({error}): pip install 'lerobot_policy_gloves[{config.type}]'"
        ) from error
    except KeyError as error:
        known = getattr(sys.modules.get(f"lerobot.envs.{config.type}"), "TASK_DESCRIPTIONS", None)
        if known is None:
            raise
        raise ValueError(
            f"env.type {config.type!r} has no task {error.args[0]!r}: choose from {', '.join(known)}"
        ) from error
