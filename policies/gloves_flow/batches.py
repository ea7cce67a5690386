"""Batches of a LeRobotDataset read at once: numbers are kept in memory, a tensor a column, and frames are decoded once.

LeRobot reads an item by itself, and each key of it by a query of its own: for the 50 actions that a copilot's item has,
that takes longer than the step of training that it is for. PyTorch's loaders ask a dataset for a whole batch if it has
`__getitems__`, which LeRobotDataset has not. What comes is the same to the bit.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_reader import DatasetReader
from torch import Tensor

from .frames import Frames


def install() -> None:
    """Teach LeRobotDataset to be asked for a batch; a flow that is made for a training does so."""
    LeRobotDataset.__getitems__ = read_batch


def read_batch(dataset: LeRobotDataset, indices: Sequence[int]) -> list[dict[str, Any]]:
    """Items of a dataset, each as `dataset[index]` returns it."""
    columns = Columns.of(dataset)
    return [dataset[index] for index in indices] if columns is None else columns.items(indices)


class Columns:
    """What a dataset holds of numbers, a tensor (frames, ...) a column, and what of it an item is made of.

    Args:
        reader: A LeRobotDataset's, loaded.
    """

    def __init__(self, reader: DatasetReader):
        self.source = reader.hf_dataset
        table, meta = reader.hf_dataset.data, reader._meta
        self.numbers = {key: _numbers(table.column(key)) for key in _numeric(reader)}
        cameras = list(meta.camera_keys)
        rest = [key for key in reader.hf_dataset.column_names if key not in self.numbers and key not in cameras]
        self.rest = reader.hf_dataset.select_columns(rest) if rest else None
        self.frames = Frames(reader, cameras, self.numbers["timestamp"]) if cameras else None
        self.transforms = reader._image_transforms
        self.deltas = {key: torch.tensor(ahead) for key, ahead in (reader.delta_indices or {}).items()}
        self.begin, self.end = (torch.tensor(meta.episodes[f"dataset_{end}_index"][:]) for end in ("from", "to"))
        self.tasks = list(meta.tasks.index)

    @classmethod
    def of(cls, dataset: LeRobotDataset) -> "Columns | None":
        """Those of a dataset, read once; None where it is to be asked item by item."""
        reader = dataset.reader
        if reader is None or reader.hf_dataset is None or dataset.writer is not None or not cls.suit(reader):
            return None
        kept = vars(reader).get("gloves_columns")
        if kept is None or kept.source is not reader.hf_dataset or kept.transforms is not reader._image_transforms:
            kept = reader.gloves_columns = cls(reader)
        return kept

    @staticmethod
    def suit(reader: DatasetReader) -> bool:
        """Whether a reader's items are numbers, and of each camera one frame, in colour."""
        meta = reader._meta
        plain = not (meta.has_language_columns or meta.depth_keys)
        return plain and set(reader.delta_indices or ()) <= set(_numeric(reader))

    def items(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """The items of frames, counted among those that were loaded."""
        rows = torch.as_tensor(indices)
        found = {key: column[rows] for key, column in self.numbers.items()}
        episode, frame, pads = found["episode_index"], found["index"], {}
        begin, end = self.begin[episode][:, None], self.end[episode][:, None]
        for key, ahead in self.deltas.items():
            asked = frame[:, None] + ahead
            # An episode's frames lie side by side, whichever episodes were loaded.
            found[key] = self.numbers[key][rows[:, None] + asked.clamp(begin, end - 1) - frame[:, None]]
            pads[f"{key}_is_pad"] = (asked < begin) | (asked >= end)
        tasks = [self.tasks[task] for task in found["task_index"].tolist()]
        frames = [{} for _ in indices] if self.frames is None else self.frames.at(rows, episode)
        items = []
        for n, (index, task) in enumerate(zip(indices, tasks, strict=True)):
            item = {} if self.rest is None else self.rest[index]
            item |= {key: column[n] for key, column in (found | pads).items()}
            seen = frames[n]
            if self.transforms is not None:
                seen = {key: self.transforms(frame) for key, frame in seen.items()}
            items.append({**item, **seen, "task": task})
        return items


def _numeric(reader: DatasetReader) -> list[str]:
    """Names of the columns that hold a number or a vector a frame."""
    return [field.name for field in reader.hf_dataset.data.schema if _is_numeric(field.type)]


def _is_numeric(kind: pa.DataType) -> bool:
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        kind = kind.value_type
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)


def _numbers(column: pa.ChunkedArray) -> Tensor:
    """A column as LeRobot makes tensors of it, from Python's numbers: in single precision, 64 bits or truth values."""
    vectors = not pa.types.is_primitive(column.type)
    chunks = chain.from_iterable([chunk.flatten()] if vectors else [chunk] for chunk in column.chunks)
    values = np.concatenate([chunk.to_numpy(zero_copy_only=False) for chunk in chunks])
    kind = {"f": np.float32, "b": np.bool_}.get(values.dtype.kind, np.int64)
    return torch.from_numpy(values.astype(kind).reshape(len(column), -1) if vectors else values.astype(kind))
