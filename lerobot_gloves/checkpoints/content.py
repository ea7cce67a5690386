"""A checkpoint by its content, wherever it lies."""

import hashlib
import json
from pathlib import Path

from huggingface_hub import snapshot_download

from lerobot_gloves.checkpoints.recommendation import RECOMMENDATION_NAME

WHAT_DECIDES = ("*.json", "*.safetensors")
"""Files of a checkpoint that an episode depends on: configuration, weights, normalisation, calibration. Not what is
recommended: whoever asks for a checkpoint's content names the method."""
PEFT_CONFIG = "adapter_config.json"
"""Where PEFT says which checkpoint it started from; its own weights are only what it added."""


def checkpoint_hash(checkpoint: str) -> str:
    """SHA-256 over the files of a checkpoint, a folder or a Hub id, that an episode depends on.

    Of one that was fine-tuned by PEFT, also over those of the checkpoint that it started from.
    """
    folder = Path(checkpoint)
    if not folder.is_dir():
        folder = Path(snapshot_download(checkpoint, allow_patterns=list(WHAT_DECIDES)))
    digest = hashlib.sha256()
    found = {path for pattern in WHAT_DECIDES for path in folder.glob(pattern)} - {folder / RECOMMENDATION_NAME}
    for path in sorted(found):
        digest.update(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    if (folder / PEFT_CONFIG).is_file():
        start = json.loads((folder / PEFT_CONFIG).read_text())["base_model_name_or_path"]
        digest.update(checkpoint_hash(start).encode())
    return digest.hexdigest()
