"""Rows: one JSON file a finished cell, with all that it takes to run the cell again."""

import hashlib
import json
import os
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from huggingface_hub import snapshot_download

from lerobot_gloves.benchmark.cell import NONE, Cell, Setup, checkpoint_config, resolve
from lerobot_gloves.benchmark.rollout import Episode

type Row = dict[str, Any]
"""What a row's file holds: cell, conditions, checkpoints, versions, seconds, episodes."""
type Conditions = dict[str, Any]
"""What decides a cell's episodes besides its seed."""

SHARED = ("env", "agent", "split", "episodes", "batch_size")
"""The conditions that all rows of a folder have in common, so that they can be compared."""
WHAT_DECIDES = ("*.json", "*.safetensors")
"""Files of a checkpoint that an episode depends on: configuration, weights, normalisation, calibration."""
PACKAGES = ("lerobot_policy_gloves", "lerobot", "torch", "numpy", "gymnasium", "mujoco")


def conditions(setup: Setup, cells: Sequence[Cell]) -> dict[Cell, Conditions]:
    """Check cells without loading weights, and write out what decides their episodes.

    Checkpoints count by content, wherever they lie.

    Raises:
        ValueError: If a cell is not valid; the message lists what is.
    """
    checkpoint_config("agent", setup.agent)
    resolved = {cell: resolve(setup, cell) for cell in cells}
    shared = {
        "env": {"type": setup.env.type, "task": setup.env.task, **setup.env.gym_kwargs},
        "agent": checkpoint_hash(setup.agent),
        "split": setup.split,
        "episodes": setup.episodes,
        "batch_size": setup.batch_size,
    }
    corrected = {"adapter": checkpoint_hash(setup.adapter)} if setup.adapter else {}
    return {
        cell: json.loads(json.dumps({**shared, **own, **(corrected if cell.method != NONE else {})}, default=str))
        for cell, own in resolved.items()
    }


def checkpoint_hash(checkpoint: str) -> str:
    """SHA-256 over the files of a checkpoint, a folder or a Hub id, that an episode depends on."""
    folder = Path(checkpoint)
    if not folder.is_dir():
        folder = Path(snapshot_download(checkpoint, allow_patterns=list(WHAT_DECIDES)))
    digest = hashlib.sha256()
    for path in sorted(path for pattern in WHAT_DECIDES for path in folder.glob(pattern)):
        digest.update(f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that an episode depends on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def row_file(folder: Path, cell: Cell) -> Path:
    """Where a cell's row lies."""
    name = f"{cell.perturbation}__{cell.method}__seed{cell.seed}"
    return folder / f"{re.sub(r'[^A-Za-z0-9_.=,+-]', '_', name)}.json"


def write_row(
    folder: Path,
    setup: Setup,
    cell: Cell,
    *,
    conditions: Conditions,
    seconds: float,
    episodes: list[Episode],
) -> None:
    """Write a row: whatever happens, its file is there whole or not at all."""
    row: Row = {
        "cell": asdict(cell),
        "conditions": conditions,
        "checkpoints": {"agent": setup.agent, "adapter": setup.adapter},
        "versions": versions(),
        "seconds": round(seconds, 3),
        "episodes": [asdict(episode) for episode in episodes],
    }
    file = row_file(folder, cell)
    temporary = file.with_suffix(f".{os.getpid()}")
    with temporary.open("w") as opened:
        json.dump(row, opened, indent=1)
        opened.flush()
        os.fsync(opened.fileno())
    temporary.replace(file)


def read_rows(folder: Path) -> list[Row]:
    """All rows of a folder.

    Raises:
        ValueError: If a file is not a row.
    """
    rows = []
    for file in sorted(folder.glob("*.json")):
        try:
            row = json.loads(file.read_text())
            Cell(**row["cell"]), row["conditions"]
            [Episode(**episode) for episode in row["episodes"]]
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{file} is not a row of gloves bench: {error}") from error
        rows.append(row)
    return rows


def finished_cells(folder: Path, planned: Mapping[Cell, Conditions]) -> set[Cell]:
    """Which of the planned cells have a row already.

    Raises:
        ValueError: If the folder holds rows that were made under other conditions.
    """
    shared = {key: value for key, value in next(iter(planned.values())).items() if key in SHARED}
    perturbations = {cell.perturbation: {"perturbation": here["perturbation"]} for cell, here in planned.items()}
    methods = {cell.method: {key: here[key] for key in here if key != "perturbation"} for cell, here in planned.items()}
    done = set()
    for row in read_rows(folder):
        cell, there = Cell(**row["cell"]), row["conditions"]
        # Whatever stands in the same line or column of the report must have been made alike.
        here = {**shared, **perturbations.get(cell.perturbation, {}), **methods.get(cell.method, {})}
        different = [f"{key}={there.get(key)}" for key in here if here[key] != there.get(key)]
        if different:
            raise ValueError(
                f"{folder} holds a row of {cell} made with {', '.join(different)}: "
                "choose another --output_dir, or delete that one"
            )
        done.add(cell)
    return done & planned.keys()
