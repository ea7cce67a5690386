"""What LeRobot asks the settings of a policy for that concerns its training alone."""

from typing import Any, ClassVar


class Untrained:
    """Settings of a policy that nobody trains; stands before `PreTrainedConfig`.

    Attributes:
        instead: What to do about it, for those who try.
    """

    instead: ClassVar[str]

    def validate_features(self) -> None:
        pass

    def get_optimizer_preset(self) -> Any:
        raise ValueError(self.instead)

    def get_scheduler_preset(self) -> None:
        return None

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> None:
        return None

    @property
    def reward_delta_indices(self) -> None:
        return None
