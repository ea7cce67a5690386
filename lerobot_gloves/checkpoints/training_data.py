"""The dataset that a checkpoint was trained on."""

import json
from pathlib import Path

from huggingface_hub import hf_hub_download
from huggingface_hub.errors import EntryNotFoundError, LocalEntryNotFoundError
from lerobot.configs.train import TRAIN_CONFIG_NAME


def trained_on(checkpoint: str, revision: str | None = None) -> str | None:
    """The name of the dataset that a checkpoint, a folder or a Hub id, was trained on; None if it does not say.

    Only `lerobot-train` writes that down. The file is read as it stands: what else it names may not be installed here.
    """
    path = Path(checkpoint) / TRAIN_CONFIG_NAME
    try:
        if not Path(checkpoint).is_dir():
            path = Path(hf_hub_download(checkpoint, TRAIN_CONFIG_NAME, revision=revision))
        return json.loads(path.read_text())["dataset"]["repo_id"]
    except (OSError, EntryNotFoundError, LocalEntryNotFoundError, ValueError, KeyError, TypeError):
        return None
