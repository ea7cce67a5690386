"""Settings of a person at the controls."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot.configs import PreTrainedConfig

from ..untrained import Untrained


@PreTrainedConfig.register_subclass("gloves_person")
@dataclass
class GlovesPersonConfig(Untrained, PreTrainedConfig):
    """A person, who commands one action at a time, as a policy that a wrapper corrects."""

    instead: ClassVar[str] = "a person is not trained: train an adapter, such as --policy.type=gloves_copilot"

    # How many actions long a proposal is: the command, held.
    chunk_size: int = 10
    # What the entries of an action are, as the robot calls them; an adapter's must be called alike.
    action_feature_names: list[str] | None = None
    # Commands a second, if anybody knows; an adapter must be of the same rate.
    fps: int | None = None
    push_to_hub: bool = False  # There is nothing to push.

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.chunk_size < 1:
            raise ValueError(f"chunk_size is {self.chunk_size}, but must be at least 1")

    @property
    def n_action_steps(self) -> int:
        """One: the next action is the next command's."""
        return 1
