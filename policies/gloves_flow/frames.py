"""A dataset's camera frames, decoded at their first visit and kept as bytes in a file that is mapped into memory.

A training visits each frame hundreds of times, and decoding one takes as long as the step that it is for.
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

    What is stored image by image is decoded image by image; of a video a whole episode at once, since its frames hang
    together. The file lies beside the data, has no name and is gone with the process that made it.

    Args:
        reader: A LeRobotDataset's, loaded.
        keys: The cameras.
        index: Of each row the frame's number in the whole dataset, (rows,).
        timestamp: Of each row its time in its episode, seconds, (rows,).
    """

    def __init__(self, reader: DatasetReader, keys: list[str], index: Tensor, timestamp: Tensor):
        self._reader, self.keys, self._index, self._timestamp = reader, keys, index, timestamp
        self._videos = [key for key in keys if key in reader._meta.video_keys]
        self._images = [key for key in keys if key not in self._videos]
        self._stored = reader.hf_dataset.select_columns(self._images) if self._images else None
        self._decoded = torch.zeros(len(reader.hf_dataset), dtype=torch.bool)
        self._kept: dict[str, Tensor | None] = {}
        self._types: dict[str, torch.dtype] = {}

    def at(self, rows: Tensor, episodes: Tensor) -> list[dict[str, Tensor]]:
        """Frames (C, H, W) of rows (B,), which are of these episodes (B,), by camera."""
        fresh: dict[int, dict[str, Tensor]] = {}
        for row, episode in zip(rows.tolist(), episodes.tolist(), strict=True):
            if row not in fresh and not self._decoded[row]:
                fresh |= self._decode(row, episode)
        return [fresh[row] if row in fresh else self._recall(row) for row in rows.tolist()]

    def _recall(self, row: int) -> dict[str, Tensor]:
        found = {}
        for key in self.keys:
            kept = self._kept[key]
            assert kept is not None  # else the row does not count as decoded
            frame = kept[row]
            found[key] = frame.clone() if self._types[key] == torch.uint8 else frame.to(self._types[key]) / 255
        return found

    def _decode(self, row: int, episode: int) -> dict[int, dict[str, Tensor]]:
        """Frames by row: that one's, and with videos all of its episode's."""
        first, count = row, 1
        found: dict[str, Tensor] = {}
        if self._videos:
            about = self._reader._meta.episodes[episode]
            first = row - int(self._index[row]) + about["dataset_from_index"]
            count = about["dataset_to_index"] - about["dataset_from_index"]
            times = self._timestamp[first : first + count].tolist()
            frames = self._reader._query_videos({key: times for key in self._videos}, episode)
            found = {key: some.reshape(count, *some.shape[-3:]) for key, some in frames.items()}
        if self._stored is not None:
            for key, some in self._stored[first : first + count].items():
                found[key] = torch.stack(list(some))
        if all([self._keep(key, first, some) for key, some in found.items()]):
            self._decoded[first : first + count] = True
        return {first + n: {key: some[n] for key, some in found.items()} for n in range(count)}

    def _keep(self, key: str, first: int, frames: Tensor) -> bool:
        """Write frames (n, C, H, W) down; False where they are more than bytes, or there is no room."""
        if key not in self._kept:
            self._types[key] = frames.dtype
            self._kept[key] = _mapped(self._reader.root, (len(self._decoded), *frames.shape[1:]))
        kept = self._kept[key]
        if kept is None:
            return False
        whole = frames if frames.dtype == torch.uint8 else (frames * 255).round().to(torch.uint8)
        same = frames.shape[1:] == kept.shape[1:] and frames.dtype == self._types[key]
        if not same or (frames.dtype != torch.uint8 and not torch.equal(whole.to(frames.dtype) / 255, frames)):
            self._kept[key] = None
            return False
        kept[first : first + len(frames)] = whole
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
