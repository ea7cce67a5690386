"""What the tasks have in common under LeRobot's commands.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.envs.utils import FreezeAfterEpisodeEnd
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lerobot_gloves.tasks.environment import CONTROL_HZ, check_observation_type

OBS_GOAL = "observation.goal"
OBS_COMMAND = "observation.command"
"""What a person commands at this moment, a raw action; no environment shows it."""
_KEYS = {"agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE, "goal": OBS_GOAL}


class ClippedAction(PolicyFeature):
    """An action of a task of ours, which it clips itself to what it takes, so that it may be any number.

    Of an environment a policy is told no more than its features: what LeRobot's commands know beside them goes here.

    Attributes:
        fps: Actions a second.
    """

    fps = CONTROL_HZ


@dataclass
class TaskConfig(EnvConfig):
    """Options of every task; those of its own come with its subclass.

    A subclass gives `task` and `episode_length`, the control steps until a timeout, their values, and names the class
    attributes below; an observation of its environment holds `agent_pos`, `goal` and either `environment_state`
    or `pixels`.

    Attributes:
        modes: The task strings that exist; a demonstration's label is its string's place among them.
        cameras: Names of the cameras that pixel observations hold.
        feature_names: What each entry of a feature is, under LeRobot's keys.
        demonstrations: How many the paper has of the task.
        robot_type: What the robot is.

    Raises:
        ValueError: If the observation type or rate is not one that exists, or a size or length is below 1.
    """

    # Control rate, in steps a second; fixed.
    fps: int = CONTROL_HZ
    # What policies observe: state, or pixels_agent_pos, where images take the place of the scene's state.
    obs_type: str = "state"
    # Height and width of frames, in pixels.
    image_size: int = 256
    # How frames are rendered: only rgb_array.
    render_mode: str = "rgb_array"
    modes: ClassVar[tuple[str, ...]]
    cameras: ClassVar[tuple[str, ...]]
    feature_names: ClassVar[dict[str, list[str]]]
    demonstrations: ClassVar[int] = 400
    robot_type: ClassVar[str] = "panda"

    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        name = type(self).__name__.removesuffix("Env")
        check_observation_type(name, self.obs_type)
        if self.fps != CONTROL_HZ:
            raise ValueError(f"{name} runs at {CONTROL_HZ} frames a second, not {self.fps}")
        for option in ("image_size", "episode_length"):
            if getattr(self, option) < 1:
                raise ValueError(f"{option} is {getattr(self, option)}, but must be at least 1")
        seen = ["agent_pos", "goal", *(["environment_state"] if self.obs_type == "state" else [])]
        self.features = {ACTION: ClippedAction(FeatureType.ACTION, (len(self.feature_names[ACTION]),))}
        for key in seen:
            kind = FeatureType.ENV if key == "environment_state" else FeatureType.STATE
            self.features[key] = PolicyFeature(kind, (len(self.feature_names[_KEYS[key]]),))
        self.features_map = {ACTION: ACTION, **{key: _KEYS[key] for key in seen}}
        if self.obs_type != "state":
            images = [f"{OBS_IMAGES}.{camera}" for camera in self.cameras]
            frame = PolicyFeature(FeatureType.VISUAL, (self.image_size, self.image_size, 3))
            self.features |= dict.fromkeys(images, frame)
            self.features_map |= {image: image for image in images}

    @property
    def package_name(self) -> str:
        """Namespace of the Gymnasium id."""
        return "gloves"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of the Gymnasium environment."""
        return {
            "obs_type": self.obs_type,
            "image_size": self.image_size,
            "episode_length": self.episode_length,
            "render_mode": self.render_mode,
        }

    def initial_state(self, seed: int) -> str | None:
        """What the episode of a seed begins with, where other seeds begin with the same; None where all differ.

        Episodes that share it are no independent ones: reports count them as a cluster.
        """
        return None

    @property
    def demonstration_kwargs(self) -> dict[str, Any]:
        """Its arguments where the scripted expert demonstrates."""
        return self.gym_kwargs

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """LeRobot's vector environment, `{type: {0: env}}`, in which one whose episode is over rests.

        LeRobot's own begins another episode in it until the last of the batch has finished: work for nothing, and
        nobody can tell that what a policy does there does not count.
        """

        def make() -> gym.Env:
            return FreezeAfterEpisodeEnd(gym.make(self.gym_id, disable_env_checker=True, **self.gym_kwargs))

        mode = AutoresetMode.SAME_STEP
        vector: VectorEnv
        if use_async_envs and n_envs > 1:
            vector = AsyncVectorEnv([make] * n_envs, autoreset_mode=mode, context="forkserver")
        else:
            vector = SyncVectorEnv([make] * n_envs, autoreset_mode=mode)
        return {self.type: {0: vector}}
