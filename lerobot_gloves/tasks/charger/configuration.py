"""Charger Plug under its name in LeRobot's commands: `--env.type=gloves_charger`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from lerobot_gloves.tasks.charger.environment import CAMERAS, TASK, check_hidden
from lerobot_gloves.tasks.configuration import OBS_GOAL, TaskConfig

if TYPE_CHECKING:
    import numpy as np

    from lerobot_gloves.tasks.charger.expert import ChargerExpert

POSE = ("x", "y", "z", "quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z")
JOINTS = (*(f"joint{i}" for i in range(1, 8)), "finger1", "finger2")
CHARGER = [f"charger_{name}" for name in POSE]
RECEPTACLE = [f"receptacle_{name}" for name in POSE]
OFFSET = ("x", "y", "z", "turn_x", "turn_y", "turn_z")
GRIP_OFFSET = [f"grip_offset_{name}" for name in OFFSET]
PLUG_OFFSET = [f"plug_offset_{name}" for name in OFFSET]
GOAL = [*RECEPTACLE, *(f"goal_{name}" for name in POSE)]


@EnvConfig.register_subclass("gloves_charger")
@dataclass
class ChargerEnv(TaskConfig):
    """Charger Plug's options; `environment.Charger` says what they mean.

    Raises:
        ValueError: If the observation type or rate is not one that exists, or pictures shall hide the receptacle.
    """

    # Name of the Gymnasium environment below "gloves/".
    task: str | None = "Charger-v0"
    # Control steps until a timeout.
    episode_length: int = 300
    # Leave the receptacle out of observation.environment_state: the ablation in which only the goal, hence only the
    # agent, says where it is.
    hide_receptacle: bool = False
    modes: ClassVar[tuple[str, ...]] = (TASK,)
    cameras: ClassVar[tuple[str, ...]] = CAMERAS
    demonstrations: ClassVar[int] = 500
    feature_names: ClassVar[dict[str, list[str]]] = {
        ACTION: [*(f"d_{joint}" for joint in JOINTS[:7]), "grip"],
        OBS_STATE: [*JOINTS, *(f"{joint}_velocity" for joint in JOINTS), *(f"tool_{name}" for name in POSE)],
        OBS_ENV_STATE: [*CHARGER, *GRIP_OFFSET, *RECEPTACLE, *PLUG_OFFSET],
        OBS_GOAL: GOAL,
    }

    def __post_init__(self) -> None:
        if self.hide_receptacle:  # the one option that changes features' lengths: these names are the instance's own
            names = {OBS_ENV_STATE: [*CHARGER, *GRIP_OFFSET], OBS_GOAL: [*GOAL, *PLUG_OFFSET]}
            self.feature_names = {**type(self).feature_names, **names}  # type: ignore[misc]
        super().__post_init__()
        check_hidden(self.obs_type, self.hide_receptacle)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `environment.Charger`."""
        return {**super().gym_kwargs, "hide_receptacle": self.hide_receptacle}

    @property
    def demonstration_kwargs(self) -> dict[str, Any]:
        """The same; the expert needs to know where the charger is even where only pixels are recorded."""
        return {**self.gym_kwargs, "privileged": True}

    def make_expert(self, rng: "np.random.Generator") -> "ChargerExpert":
        """The scripted expert that demonstrates this task."""
        from lerobot_gloves.tasks.charger.expert import ChargerExpert

        return ChargerExpert(rng)
