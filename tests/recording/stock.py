"""Environments as LeRobot's own are: no scripted expert, no modes, and observations in each of the forms there are."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.processor import ObservationProcessorStep, PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_IMAGES, OBS_STATE

SIZE = 64
START = np.array([0.25, -0.5])


class Reach(gym.Env):
    """A point that moves by each action; its picture shows the number of steps. Succeeds never.

    Args:
        shows: `array`, one image under `pixels`, as gym-pusht and MetaWorld; `dict`, as gym-aloha; `nested`, where a
            processor of the environment makes the state, as LIBERO.
        render_mode: As Gymnasium wants it.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}
    action_space = spaces.Box(-10, 10, (2,), np.float32)

    def __init__(self, shows: str, render_mode: str = "rgb_array"):
        self.shows, self.render_mode = shows, render_mode
        image, state = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8), spaces.Box(-np.inf, np.inf, (2,), np.float64)
        pixels = image if shows == "array" else spaces.Dict({"top": image})
        joints = {"robot_state": spaces.Dict({"at": state})} if shows == "nested" else {"agent_pos": state}
        self.observation_space = spaces.Dict({"pixels": pixels, **joints})

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = START.copy(), 0
        return self._see(), {"is_success": False}

    def step(self, action):
        self.at, self.steps = self.at + action, self.steps + 1
        return self._see(), 0.0, False, False, {"is_success": False}

    def _see(self) -> dict[str, Any]:
        image = self.render()
        pixels = image if self.shows == "array" else {"top": image}
        joints = {"robot_state": {"at": self.at}} if self.shows == "nested" else {"agent_pos": self.at}
        return {"pixels": pixels, **joints}

    def render(self) -> np.ndarray:
        return np.full((SIZE, SIZE, 3), 10 * self.steps, np.uint8)


gym.register("gym_reach/Reach-v0", Reach)


class StateOfJoints(ObservationProcessorStep):
    """Makes a state of what is nested, as LIBERO's does."""

    def observation(self, observation):
        state = observation.pop("observation.robot_state")["at"]
        return {**observation, OBS_STATE: state.to(torch.float32)}

    def transform_features(self, features):
        return features


@EnvConfig.register_subclass("reach")
@dataclass
class ReachEnv(EnvConfig):
    """Its options."""

    task: str | None = "Reach-v0"
    fps: int = 10
    shows: str = "array"
    episode_length: int = 10
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {ACTION: PolicyFeature(FeatureType.ACTION, (2,))}
    )

    def __post_init__(self) -> None:
        image = PolicyFeature(FeatureType.VISUAL, (SIZE, SIZE, 3))
        self.features |= {"agent_pos": PolicyFeature(FeatureType.STATE, (2,)), "pixels": image}
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE, "pixels": self.image}

    @property
    def image(self) -> str:
        """The key under which LeRobot gives the image to a policy."""
        return OBS_IMAGE if self.shows == "array" else f"{OBS_IMAGES}.top"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {"shows": self.shows, "max_episode_steps": self.episode_length}

    def get_env_processors(self):
        steps = [StateOfJoints()] if self.shows == "nested" else []
        return PolicyProcessorPipeline(steps=steps), PolicyProcessorPipeline(steps=[])
