"""CAN under its name in LeRobot's commands: `--env.type=gloves_can`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from lerobot_gloves.tasks.can.scene import CAMERAS, MODES, QUADRANTS, parse_mode
from lerobot_gloves.tasks.configuration import OBS_GOAL, TaskConfig

if TYPE_CHECKING:
    import numpy as np

    from lerobot_gloves.tasks.can.expert import CanExpert


@EnvConfig.register_subclass("gloves_can")
@dataclass
class CanEnv(TaskConfig):
    """CAN's options; `environment.Can` says what they mean.

    Raises:
        ValueError: If the observation type, mode or rate is not one that exists.
    """

    # Name of the Gymnasium environment below "gloves/".
    task: str | None = "Can-v0"
    # Control steps until a timeout.
    episode_length: int = 400
    # Quadrant of every episode, as an instruction or a name such as "top left"; null lets the seed choose.
    mode: str | None = None
    modes: ClassVar[tuple[str, ...]] = MODES
    cameras: ClassVar[tuple[str, ...]] = tuple(CAMERAS)
    feature_names: ClassVar[dict[str, list[str]]] = {
        ACTION: ["dx", "dy", "dz", "turn_x", "turn_y", "turn_z", "grip"],
        OBS_STATE: ["x", "y", "z", "quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z", "finger_distance"],
        OBS_ENV_STATE: [f"can_{name}_{axis}" for name in ("position", "axis", "from_grip") for axis in "xyz"],
        OBS_GOAL: [name.replace(" ", "_") for name in QUADRANTS],
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode is not None:
            parse_mode(self.mode)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `environment.Can`."""
        return {**super().gym_kwargs, "mode": self.mode}

    @property
    def demonstration_kwargs(self) -> dict[str, Any]:
        """The same; the expert needs to know where the can is even where only pixels are recorded."""
        return {**self.gym_kwargs, "privileged": True}

    def make_expert(self, rng: "np.random.Generator") -> "CanExpert":
        """The scripted expert that demonstrates this task."""
        from lerobot_gloves.tasks.can.expert import CanExpert

        return CanExpert(rng)
