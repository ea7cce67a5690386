"""MetaWorld's own experts, one a task, in the environments that LeRobot makes of MetaWorld."""

import warnings
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np


class MetaworldExpert:
    """Demonstrates the task of one of LeRobot's MetaWorld environments.

    It reads the simulator's whole state (objects and goal), not what policies observe, and draws nothing: its episode
    follows from the initial state.

    Args:
        env: LeRobot's `MetaworldEnv`.
    """

    def __init__(self, env: gym.Env):
        self._env: Any = env.unwrapped
        self.reset("")

    def reset(self, mode: str) -> None:
        self._policy = type(self._env.expert_policy)()  # some remember what they have done

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The action (4,), float32, in [-1, 1].

        The experts ask for up to 20 and rely on the simulator, which clips; what is recorded is what was executed.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MetaWorld's of exactly that, at nearly every step
            wanted = self._policy.get_action(self._env._env.unwrapped._get_obs())
        space = self._env.action_space
        return np.clip(wanted, space.low, space.high).astype(np.float32)

    def disturb(self, action: np.ndarray) -> np.ndarray:
        return action
