"""Slalom under its name in LeRobot's commands: `--env.type=gloves_slalom`."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.envs.utils import FreezeAfterEpisodeEnd
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from lerobot_gloves.tasks.slalom.environment import CONTROL_HZ, check_observation_type
from lerobot_gloves.tasks.slalom.scene import CAMERA, GAPS, MODES, PILLARS, parse_mode

if TYPE_CHECKING:
    import numpy as np

    from lerobot_gloves.tasks.slalom.expert import SlalomExpert


@EnvConfig.register_subclass("gloves_slalom")
@dataclass
class SlalomEnv(EnvConfig):
    """Slalom's options; `environment.Slalom` says what they mean.

    Attributes:
        task: Name of the Gymnasium environment below "gloves/".
        fps: Control rate; fixed.
        episode_length: Control steps until a timeout.
        obs_type: "state" or "pixels_agent_pos".
        image_size: Height and width of frames, in pixels.
        mode: Corridor of every episode, such as "0 2 3"; None lets the seed choose.
        render_mode: Only "rgb_array".
        modes: The task strings that exist; a demonstration's label is its string's place among them.
        feature_names: What each entry of a feature is, under LeRobot's keys.

    Raises:
        ValueError: If the observation type, mode or rate is not one that exists.
    """

    task: str | None = "Slalom-v0"
    fps: int = CONTROL_HZ
    episode_length: int = 300
    obs_type: str = "state"
    image_size: int = 256
    mode: str | None = None
    render_mode: str = "rgb_array"
    modes: ClassVar[tuple[str, ...]] = MODES
    feature_names: ClassVar[dict[str, list[str]]] = {
        ACTION: ["dx", "dy"],
        OBS_STATE: ["set_point_x", "set_point_y", "tip_x", "tip_y"],
        OBS_ENV_STATE: [f"pillar_{i}_{axis}" for i in range(1, len(PILLARS) + 1) for axis in "xy"],
        "observation.goal": [f"row_{row}_gap_{gap}" for row, n in enumerate(GAPS) for gap in range(n)],
    }

    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_observation_type(self.obs_type)
        if self.mode is not None:
            parse_mode(self.mode)
        if self.fps != CONTROL_HZ:
            raise ValueError(f"Slalom runs at {CONTROL_HZ} frames a second, not {self.fps}")
        image = f"{OBS_IMAGES}.{CAMERA}"
        features: dict[str, tuple[str, FeatureType, tuple[int, ...]]] = {
            ACTION: (ACTION, FeatureType.ACTION, (2,)),
            "agent_pos": (OBS_STATE, FeatureType.STATE, (4,)),
            "goal": ("observation.goal", FeatureType.STATE, (sum(GAPS),)),
        }
        if self.obs_type == "state":
            features["environment_state"] = (OBS_ENV_STATE, FeatureType.ENV, (PILLARS.size,))
        else:
            features[image] = (image, FeatureType.VISUAL, (self.image_size, self.image_size, 3))
        self.features = {key: PolicyFeature(type=kind, shape=shape) for key, (_, kind, shape) in features.items()}
        self.features_map = {key: policy_key for key, (policy_key, _, _) in features.items()}

    @property
    def package_name(self) -> str:
        """Namespace of the Gymnasium id."""
        return "gloves"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `environment.Slalom`."""
        return {
            "obs_type": self.obs_type,
            "image_size": self.image_size,
            "episode_length": self.episode_length,
            "mode": self.mode,
            "render_mode": self.render_mode,
        }

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

    def make_expert(self, rng: "np.random.Generator") -> "SlalomExpert":
        """The scripted expert that demonstrates this task."""
        from lerobot_gloves.tasks.slalom.expert import SlalomExpert

        return SlalomExpert(rng)
