"""Which episodes of a task begin alike: what the task itself says of their seeds."""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import fields
from typing import Any

from lerobot.envs import EnvConfig

import lerobot_gloves.tasks  # noqa: F401, makes our tasks known


def initial_state(env: Mapping[str, Any]) -> Callable[[int], Hashable]:
    """What the episode of a seed begins with, equal for episodes that begin alike.

    A task whose configuration has a method `initial_state(seed)`, like `TaskConfig`, says so; of others, and where that
    is None, every seed begins in a way of its own.

    Args:
        env: A row's: the type of the task and its options.
    """
    kind = EnvConfig.get_known_choices().get(env["type"])
    if not hasattr(kind, "initial_state"):
        return lambda seed: seed
    known = {one.name for one in fields(kind)}  # rows of before may have options that there are no longer
    task = kind(**{name: value for name, value in env.items() if name in known})

    def state(seed: int) -> Hashable:
        found = task.initial_state(seed)
        return seed if found is None else found

    return state
