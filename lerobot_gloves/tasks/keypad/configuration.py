"""Keypad under its name in LeRobot's commands: `--env.type=gloves_keypad`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from lerobot_gloves.tasks.configuration import OBS_GOAL, TaskConfig
from lerobot_gloves.tasks.keypad.scene import CAMERAS, CODES, PRESSES, check_mode, code_of

if TYPE_CHECKING:
    import numpy as np

    from lerobot_gloves.tasks.keypad.expert import KeypadExpert


@EnvConfig.register_subclass("gloves_keypad")
@dataclass
class KeypadEnv(TaskConfig):
    """Keypad's options; `environment.Keypad` says what they mean.

    Demonstrations are single presses, whatever `episode` says.

    Raises:
        ValueError: If the observation type, episode, mode or rate is not one that exists.
    """

    # Name of the Gymnasium environment below "gloves/".
    task: str | None = "Keypad-v0"
    # Control steps until a timeout.
    episode_length: int = 1000
    # What an episode is: code, three presses, or press, a single one.
    episode: str = "code"
    # Code of every episode, such as "4 0 8", or the button to press, such as "4"; null lets the seed choose.
    mode: str | None = None
    modes: ClassVar[tuple[str, ...]] = (*PRESSES, *CODES)
    cameras: ClassVar[tuple[str, ...]] = CAMERAS
    demonstrations: ClassVar[int] = 450
    feature_names: ClassVar[dict[str, list[str]]] = {
        ACTION: ["dx", "dy", "dz"],
        OBS_STATE: [f"{what}_{axis}" for what in ("tip", "set_point", "velocity") for axis in "xyz"],
        OBS_ENV_STATE: [f"{what}_{button}" for what in ("travel", "light") for button in PRESSES],
        OBS_GOAL: [f"button_{button}" for button in PRESSES],
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        check_mode(self.episode, self.mode)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `environment.Keypad`."""
        return {**super().gym_kwargs, "episode": self.episode, "mode": self.mode}

    @property
    def demonstration_kwargs(self) -> dict[str, Any]:
        """The same for single presses, which make up codes."""
        return {**self.gym_kwargs, "episode": "press"}

    def initial_state(self, seed: int) -> str | None:
        """The code, where nothing else differs; a press is a cut-out of its own."""
        return (self.mode or code_of(seed)) if self.episode == "code" else None

    def make_expert(self, rng: "np.random.Generator") -> "KeypadExpert":
        """The scripted expert that demonstrates this task."""
        from lerobot_gloves.tasks.keypad.expert import KeypadExpert

        return KeypadExpert(rng)
