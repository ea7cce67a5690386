"""A dataset's camera frames, decoded at their first visit and kept as bytes in a file that is mapped into memory.

A training visits each frame many times, and LeRobot decodes it at every visit.
"""

import logging
import os
import tempfile
from pathlib import Path

import numpy as np
import torch
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor

logger = logging.getLogger(__name__)


class Frames:
    """Frames by camera and row, as LeRobot decodes them, bit for bit.

    The file lies beside the data, has no name and is gone with the process that made it. Besides it no more is held
    than the batch: not a video's episode, which may be larger than the memory.

    Args:
        reader: A LeRobotDataset's, loaded.
        keys: The cameras.
        timestamp: Of each row its time in its episode, seconds, (rows,).
    """

    def __init__(self, reader: DatasetReader, keys: list[str], timestamp: Tensor):
        self._reader, self._keys, self._timestamp = reader, keys, timestamp
        self._videos = [key for key in keys if key in reader._meta.video_keys]
        images = [key for key in keys if key not in self._videos]
        self._stored = reader.hf_dataset.select_columns(images) if images else None
        self._decoded = torch.zeros(len(reader.hf_dataset), dtype=torch.bool)
        self._kept: dict[str, Tensor | None] = {}
        self._types: dict[str, torch.dtype] = {}

    def at(self, rows: Tensor, episodes: Tensor) -> list[dict[str, Tensor]]:
        """Frames (C, H, W) of rows (B,), which are of these episodes (B,), by camera."""
        return [
            self._recall(row) if self._decoded[row] else self._decode(row, episode)
            for row, episode in zip(rows.tolist(), episodes.tolist(), strict=True)
        ]

    def _recall(self, row: int) -> dict[str, Tensor]:
        found = {}
        for key in self._keys:
            kept = self._kept[key]
            assert kept is not None  # else the row does not count as decoded
            frame = kept[row]
            found[key] = frame.clone() if self._types[key] == torch.uint8 else frame.to(self._types[key]) / 255
        return found

    def _decode(self, row: int, episode: int) -> dict[str, Tensor]:
        found: dict[str, Tensor] = {} if self._stored is None else dict(self._stored[row])
        if self._videos:
            now = [self._timestamp[row].item()]
            found |= self._reader._query_videos({key: now for key in self._videos}, episode)
        self._decoded[row] = all([self._keep(key, row, frame) for key, frame in found.items()])
        return found

    def _keep(self, key: str, row: int, frame: Tensor) -> bool:
        """Write a frame (C, H, W) down; False where it is more than bytes, or there is no room."""
        if key not in self._kept:
            self._types[key] = frame.dtype
            self._kept[key] = _mapped(self._reader.root, (len(self._decoded), *frame.shape))
        kept = self._kept[key]
        if kept is None or frame.shape != kept.shape[1:] or frame.dtype != self._types[key]:
            return False
        whole = frame if frame.dtype == torch.uint8 else (frame * 255).round().to(torch.uint8)
        if frame.dtype != torch.uint8 and not torch.equal(whole.to(frame.dtype) / 255, frame):
            return False
        kept[row] = whole
        return True


def _mapped(folder: Path, shape: tuple[int, ...]) -> Tensor | None:
    """Room for so many bytes in a file without a name; None where there is none."""
    size = int(np.prod(shape))
    try:
        with tempfile.TemporaryFile(dir=folder if os.access(folder, os.W_OK) else None) as file:
            # Mapped bytes that find no room would end the process, so they are reserved where there is a way.
            (getattr(os, "posix_fallocate", None) or _extend)(file.fileno(), 0, size)
            return torch.from_numpy(np.memmap(file, np.uint8, "r+", shape=shape))
    except OSError as error:
        logger.warning("no room for %.1f GB of frames (%s): each is decoded at every visit", size / 1e9, error)
        return None


def _extend(descriptor: int, offset: int, size: int) -> None:
    os.truncate(descriptor, offset + size)
