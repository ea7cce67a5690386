"""A wrapper as a checkpoint: its configuration, which says where agent and adapter are."""

import copy
import shutil
from pathlib import Path
from typing import Self

from lerobot.configs import PreTrainedConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from .configuration_gloves import PASSTHROUGH, GlovesConfig


class SavedWrapper(PreTrainedPolicy):
    """How a wrapper is saved and loaded."""

    config_class = GlovesConfig
    name = "gloves"

    config: GlovesConfig

    @classmethod
    def from_pretrained(
        cls,
        pretrained_name_or_path: str | Path,
        *,
        config: PreTrainedConfig | None = None,
        revision: str | None = None,
        **_: object,
    ) -> Self:
        """A saved wrapper is its configuration; agent and adapter are loaded from where it says."""
        config = config or PreTrainedConfig.from_pretrained(pretrained_name_or_path, revision=revision)
        if not isinstance(config, GlovesConfig):  # a server loads what its client names
            raise ValueError(f"{pretrained_name_or_path} is a policy of type {config.type!r}, no saved wrapper")
        return cls(config).eval()

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        saved = copy.copy(self.config)
        saved.pretrained_path = None
        for name in ("agent", "adapter"):
            checkpoint = getattr(saved, name)
            if checkpoint is not None and Path(checkpoint).is_dir():
                setattr(saved, name, str(Path(checkpoint).resolve()))  # wherever the wrapper will be used from
        saved._save_pretrained(save_directory)
        for pipeline in PASSTHROUGH.glob("*.json"):
            shutil.copy(pipeline, save_directory)
