"""Who demonstrates a task: the expert that its `EnvConfig` offers, or one that is registered for it here.

A stock environment, LeRobot's own or anybody's, offers none. Whoever knows an expert for it registers that under its
`--env.type`, in a package that LeRobot imports as a plugin:

    @register_expert("pusht")
    def pushts(env: gym.Env, rng: np.random.Generator) -> Expert:
        return MyExpert(env.unwrapped, rng)
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from lerobot.configs import PolicyFeature
from lerobot.envs import EnvConfig

from lerobot_gloves.recording.metaworld import MetaworldExpert


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
    """What an `EnvConfig` offers when its task has a scripted expert of its own."""

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


type MakeExpert = Callable[[np.random.Generator], Expert]
"""Makes an expert that takes all its draws from a generator."""
type StockExpert = Callable[[gym.Env, np.random.Generator], Expert]
"""The same for one of a stock environment's simulations, as LeRobot makes it: an expert may see all that is in it."""

EXPERTS: dict[str, StockExpert] = {"metaworld": lambda env, rng: MetaworldExpert(env)}
"""The experts of stock environments, by `--env.type`."""


def register_expert(env_type: str) -> Callable[[StockExpert], StockExpert]:
    """Enter the decorated function as the expert of an environment that offers none.

    Args:
        env_type: Its `--env.type`.
    """

    def enter(make: StockExpert) -> StockExpert:
        EXPERTS[env_type] = make
        return make

    return enter


def check_expert(env_config: EnvConfig) -> None:
    """Refuse a task that has no scripted expert.

    Raises:
        ValueError: If it has none; names those that have.
    """
    if isinstance(env_config, Recordable) or env_config.type in EXPERTS:
        return
    own = (name for name, cls in EnvConfig.get_known_choices().items() if hasattr(cls, "make_expert"))
    raise ValueError(
        f"env.type {env_config.type!r} has no scripted expert: choose one of {', '.join(sorted({*own, *EXPERTS}))}, or "
        "record a policy by --agent"
    )


def expert_of(env_config: EnvConfig, env: gym.Env) -> MakeExpert:
    """Who demonstrates a task.

    Args:
        env_config: The task, one that `check_expert` lets pass.
        env: Where it is demonstrated.
    """
    return env_config.make_expert if isinstance(env_config, Recordable) else partial(EXPERTS[env_config.type], env)
