"""One file per finished episode, so that a recording killed at any moment loses at most what is in flight.

An open LeRobotDataset cannot do that: it neither loads nor resumes when its writer is killed.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION

from lerobot_gloves.system.files import whole

_FACTS = ("task", "attempts", "failure")


@dataclass(frozen=True)
class StagedEpisode:
    """A finished episode.

    Attributes:
        frames: For each feature of the dataset, under its LeRobot key, an array (L, ...): a demonstration's over its L
            steps; an agent's over the L moments at which it was queried, with chunks (L, T, A) for actions.
        task: The task string.
        attempts: How often it was played until it succeeded.
        failure: Why it failed, where failures are kept; "" for a success.
    """

    frames: dict[str, np.ndarray]
    task: str
    attempts: int = 1
    failure: str = ""

    def rows(self) -> Iterator[dict[str, np.ndarray]]:
        """The dataset's rows: one an action, all actions of a chunk with the observation that it was made from."""
        for step, actions in enumerate(self.frames[ACTION]):
            row = {key: values[step] for key, values in self.frames.items()}
            for action in np.atleast_2d(actions):
                yield row | {ACTION: action}


def staging_folder(root: Path) -> Path:
    """Where the episodes of the dataset `root` wait: beside it, so that `root` only ever holds a whole dataset."""
    return root.with_name(root.name + ".staging")


def open_staging(folder: Path, settings: Mapping[str, Any]) -> None:
    """Create a staging folder, or take up one that was recorded with the same settings.

    Args:
        folder: The staging folder.
        settings: What the episodes depend on.

    Raises:
        ValueError: If the folder holds episodes that were recorded with other settings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings = json.loads(json.dumps(settings, default=str))  # as it will be read again: any environment's arguments
    file = folder / "settings.json"
    if not file.exists() or not staged(folder):  # what was begun otherwise has come to nothing
        with whole(file) as part:
            part.write_text(json.dumps(settings, indent=2))
        return
    found = json.loads(file.read_text())
    different = sorted(key for key in found.keys() | settings.keys() if found.get(key) != settings.get(key))
    if different:
        had = ", ".join(f"{key}={found.get(key)}" for key in different)
        raise ValueError(f"{folder} holds episodes recorded with {had}: use the same options or delete that folder")


def staged(folder: Path) -> set[int]:
    """Numbers of the finished episodes."""
    return {int(file.stem.removeprefix("episode_")) for file in folder.glob("episode_*.npz")}


def save(folder: Path, index: int, episode: StagedEpisode) -> None:
    """Write episode `index`; after a crash it is there whole or not at all."""
    facts = {name: np.array(getattr(episode, name)) for name in _FACTS}
    with whole(_episode_file(folder, index)) as part, part.open("wb") as archive:
        np.savez_compressed(archive, **facts, **episode.frames)  # type: ignore[arg-type]


def load(folder: Path, index: int) -> StagedEpisode:
    """Read episode `index`."""
    with np.load(_episode_file(folder, index)) as arrays:
        frames = {key: arrays[key] for key in arrays.files if key not in _FACTS}
        facts = {name: arrays[name].item() for name in _FACTS}
        return StagedEpisode(frames=frames, **facts)


def _episode_file(folder: Path, index: int) -> Path:
    return folder / f"episode_{index:06d}.npz"
