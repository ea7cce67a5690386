"""A checkpoint by its content, wherever it lies."""

import hashlib
from pathlib import Path

from huggingface_hub import snapshot_download

WHAT_DECIDES = ("*.json", "*.safetensors")
"""Files of a checkpoint that an episode depends on: configuration, weights, normalisation, calibration."""


def checkpoint_hash(checkpoint: str) -> str:
    """SHA-256 over the files of a checkpoint, a folder or a Hub id, that an episode depends on."""
    folder = Path(checkpoint)
    if not folder.is_dir():
        folder = Path(snapshot_download(checkpoint, allow_patterns=list(WHAT_DECIDES)))
    digest = hashlib.sha256()
    for path in sorted(path for pattern in WHAT_DECIDES for path in folder.glob(pattern)):
        digest.update(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()
