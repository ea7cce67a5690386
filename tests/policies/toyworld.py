"""A point that moves as it is told, and is shown as Slalom is: quick to draw, without a simulator, with a task text."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig, make_env
from lerobot.utils.constants import ACTION

from tests.builders import SIZE

LONGEST = 14
"""Steps of the longest episode; the shortest has four fewer."""
TASKS = ("move left", "go right")


class World(gym.Env):
    """Where the point is depends on every action, and what the picture shows on where it is.

    Episodes of neighbouring seeds have other lengths and other tasks.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}
    action_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
    observation_space = spaces.Dict(
        {
            "pixels": spaces.Dict({"front": spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)}),
            "agent_pos": spaces.Box(-np.inf, np.inf, (4,), np.float64),
            "environment_state": spaces.Box(-np.inf, np.inf, (12,), np.float64),
            "goal": spaces.Box(0, 1, (9,), np.float64),
        }
    )

    def __init__(self, render_mode: str = "rgb_array"):
        self.render_mode, self.task_description = render_mode, TASKS[0]
        self.task = "World-v0"  # LeRobot asks for both, and a process that is asked for what it has not ends

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(100)) if seed is None else seed
        self.task_description, self.length = TASKS[drawn % 2], LONGEST - drawn % 5
        self.at, self.before, self.steps = self.np_random.normal(size=2), np.zeros(2), 0
        self.pillars, self.texture = self.np_random.normal(size=12), self.np_random.integers(0, 255, (SIZE, SIZE, 3))
        return self._see(), {"is_success": False}

    def step(self, action):
        self.before, self.at, self.steps = self.at, self.at + action, self.steps + 1
        return self._see(), 0.0, self.steps >= self.length, False, {"is_success": False}

    def _see(self) -> dict[str, Any]:
        vectors = {"environment_state": self.pillars, "goal": np.eye(9)[TASKS.index(self.task_description)]}
        return {"pixels": {"front": self.render()}, "agent_pos": np.concatenate([self.at, self.before]), **vectors}

    def render(self) -> np.ndarray:
        moved = np.roll(self.texture, self.steps, axis=0) + (1000 * self.at[0]).round()
        return (moved % 256).astype(np.uint8)


gym.register("gym_toyworld/World-v0", World)


@EnvConfig.register_subclass("toyworld")
@dataclass
class WorldEnv(EnvConfig):
    """Its options."""

    task: str | None = "World-v0"
    fps: int = 10
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {ACTION: PolicyFeature(FeatureType.ACTION, (2,))}
    )
    features_map: dict[str, str] = field(default_factory=lambda: {ACTION: ACTION})

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {"max_episode_steps": LONGEST}


@contextmanager
def world(batch: int, *, in_processes: bool = False) -> Iterator[gym.vector.VectorEnv]:
    """LeRobot's vector environment of it, each in a process of its own or all in this one."""
    env = make_env(WorldEnv(), n_envs=batch, use_async_envs=in_processes)["toyworld"][0]
    try:
        yield env
    finally:
        env.close()
