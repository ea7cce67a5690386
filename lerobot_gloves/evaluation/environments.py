"""A batch of a task's environments, as LeRobot makes them."""

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import gymnasium as gym
from lerobot.envs import EnvConfig, close_envs, make_env

from lerobot_gloves.evaluation.agent import quiet
from lerobot_gloves.evaluation.rendering import attend

EXTRAS = ("metaworld", "pusht")
"""Those of LeRobot's own environments that an extra of ours installs, which has the name of their `--env.type`."""


@contextmanager
def environments(
    config: EnvConfig, batch_size: int, *, fast_rendering: bool = False
) -> Iterator[gym.vector.SyncVectorEnv]:
    """A batch of one task's environments, all in this process.

    Args:
        config: The task.
        batch_size: How many.
        fast_rendering: Whether MuJoCo draws without multisampling and with coarser shadows.

    Raises:
        ValueError: If they are several tasks, or run in processes of their own, or there is no such task, or fast
            rendering is not for it.
        ModuleNotFoundError: If the simulator is not installed.
    """
    with _open(config, batch_size) as found:
        if len(found) != 1:
            raise ValueError(f"env.type {config.type!r} is {len(found)} tasks here: choose one by --env.task")
        with _drawn(config, found, fast_rendering):
            yield found[0]


@contextmanager
def every_task(
    config: EnvConfig, batch_size: int, *, fast_rendering: bool = False
) -> Iterator[list[gym.vector.SyncVectorEnv]]:
    """The same for each of the tasks that an environment is, such as those of a benchmark's suite."""
    with _open(config, batch_size) as found, _drawn(config, found, fast_rendering):
        yield found


@contextmanager
def _open(config: EnvConfig, batch_size: int) -> Iterator[list[gym.vector.SyncVectorEnv]]:
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


@contextmanager
def _drawn(config: EnvConfig, envs: Sequence[gym.vector.SyncVectorEnv], fast: bool) -> Iterator[None]:
    """Environments whose pictures are right side by side, until they are closed."""
    drawn = attend(envs, fast=fast)
    refuse_fast(config, fast and not drawn)
    try:
        yield
    finally:
        for pictures in drawn:
            pictures.release()


def refuse_fast(config: EnvConfig, asked: bool) -> None:
    """Refuse fast rendering of what Gymnasium's MuJoCo environments do not draw, if it is asked for."""
    if asked:
        raise ValueError(
            f"env.type {config.type!r} is none of Gymnasium's MuJoCo environments: leave out fast_rendering"
        )


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
