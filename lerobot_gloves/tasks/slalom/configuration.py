"""Slalom under its name in LeRobot's commands: `--env.type=gloves_slalom`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from lerobot_gloves.tasks.configuration import OBS_GOAL, TaskConfig
from lerobot_gloves.tasks.slalom.scene import CAMERA, GAPS, MODES, PILLARS, mode_of, parse_mode

if TYPE_CHECKING:
    import numpy as np

    from lerobot_gloves.tasks.slalom.expert import SlalomExpert


@EnvConfig.register_subclass("gloves_slalom")
@dataclass
class SlalomEnv(TaskConfig):
    """Slalom's options; `environment.Slalom` says what they mean.

    Raises:
        ValueError: If the observation type, mode or rate is not one that exists.
    """

    # Name of the Gymnasium environment below "gloves/".
    task: str | None = "Slalom-v0"
    # Control steps until a timeout.
    episode_length: int = 300
    # Corridor of every episode, such as "0 2 3"; null lets the seed choose.
    mode: str | None = None
    modes: ClassVar[tuple[str, ...]] = MODES
    cameras: ClassVar[tuple[str, ...]] = (CAMERA,)
    feature_names: ClassVar[dict[str, list[str]]] = {
        ACTION: ["dx", "dy"],
        OBS_STATE: ["set_point_x", "set_point_y", "tip_x", "tip_y"],
        OBS_ENV_STATE: [f"pillar_{i}_{axis}" for i in range(1, len(PILLARS) + 1) for axis in "xy"],
        OBS_GOAL: [f"row_{row}_gap_{gap}" for row, n in enumerate(GAPS) for gap in range(n)],
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode is not None:
            parse_mode(self.mode)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `environment.Slalom`."""
        return {**super().gym_kwargs, "mode": self.mode}

    def initial_state(self, seed: int) -> str:
        """The corridor: nothing else differs."""
        return self.mode or mode_of(seed)

    def make_expert(self, rng: "np.random.Generator") -> "SlalomExpert":
        """The scripted expert that demonstrates this task."""
        from lerobot_gloves.tasks.slalom.expert import SlalomExpert

        return SlalomExpert(rng)
