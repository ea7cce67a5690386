"""A person as an agent: what is commanded comes with the observation, and the proposal is that command, held."""

from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_gloves.tasks.configuration import OBS_COMMAND

from .configuration_gloves_person import GlovesPersonConfig


class GlovesPersonPolicy(PreTrainedPolicy):
    """Proposes at every step that the command of that step be held for a chunk; of which one action is executed.

    Commands are raw actions (B, A) under the observation key `observation.command`, which no environment has: whoever
    asks for an action puts them there.
    """

    config_class = GlovesPersonConfig
    name = "gloves_person"

    def __init__(self, config: GlovesPersonConfig, **_: object):
        super().__init__(config)

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: PreTrainedConfig | None = None, **_: object
    ) -> "GlovesPersonPolicy":
        """A person has no weights."""
        config = config or PreTrainedConfig.from_pretrained(pretrained_name_or_path)
        assert isinstance(config, GlovesPersonConfig)
        return cls(config).eval()

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        self.config._save_pretrained(save_directory)

    def predict_action_chunk(self, batch: dict[str, Any], **_: Any) -> Tensor:
        """The command, held: (B, T, A).

        Raises:
            ValueError: If nobody commands.
        """
        if OBS_COMMAND not in batch:
            raise ValueError(f"a person acts by {OBS_COMMAND}, which is not there: run gloves drive")
        return batch[OBS_COMMAND][:, None].repeat(1, self.config.chunk_size, 1)

    def select_action(self, batch: dict[str, Any], **_: Any) -> Tensor:
        return self.predict_action_chunk(batch)[:, 0]

    def reset(self) -> None:
        pass

    def get_optim_params(self) -> dict:
        return self.config.get_optimizer_preset()

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict | None]:
        return self.config.get_optimizer_preset()
