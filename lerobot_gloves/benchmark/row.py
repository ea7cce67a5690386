"""Rows: one JSON file a finished cell, with all that it takes to run the cell again."""

import functools
import hashlib
import json
import os
import platform
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from huggingface_hub import snapshot_download

from lerobot_gloves.benchmark.cell import (
    NONE,
    Cell,
    Setup,
    agent_flow,
    resolve_method,
    resolve_perturbation,
)
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.evaluation.rollout import Episode

type Row = dict[str, Any]
"""What a row's file holds: cell, conditions, checkpoints, versions, seconds, episodes."""
type Conditions = dict[str, Any]
"""What decides a cell's episodes besides its seed."""

SHARED = ("env", "agent", "split", "episodes", "batch_size")
"""The conditions that all rows of a task have in common, so that they can be compared."""
WHAT_DECIDES = ("*.json", "*.safetensors")
"""Files of a checkpoint that an episode depends on: configuration, weights, normalisation, calibration."""
PACKAGES = ("lerobot_policy_gloves", "lerobot", "torch", "numpy", "gymnasium", "mujoco", "robosuite", "diffusers")


@dataclass(frozen=True, eq=False)
class Job:
    """A cell to be played, and all that it takes."""

    setup: Setup
    cell: Cell
    conditions: Conditions


def plan(matrix: Iterable[tuple[Setup, Cell]]) -> list[Job]:
    """Check cells without loading weights, and write out what decides their episodes.

    Raises:
        ValueError: If a cell is not valid, the message lists what is; or if the rows of two would lie in one file.
    """
    content, config = functools.cache(checkpoint_hash), functools.cache(checkpoint_config)
    second_checkpoint = functools.cache(agent_flow)

    @functools.cache
    def without_perturbation(setup: Setup, method: str) -> Conditions:
        config("agent", setup.agent)
        own = resolve_method(setup, method)
        shared = {
            "env": {"type": setup.env.type, "task": setup.env.task, **setup.env.gym_kwargs},
            "agent": content(setup.agent),
            "split": setup.split,
            "episodes": setup.episodes,
            "batch_size": setup.batch_size,
        }
        return {**shared, **own, **({} if method == NONE else {"adapter": content(setup.adapter)})}

    jobs: dict[Path, Job] = {}
    for setup, cell in matrix:
        file = row_file(Path(), cell)
        if file in jobs:
            raise ValueError(f"{jobs[file].cell} and {cell} have the same name: label them differently")
        own = {**without_perturbation(setup, cell.method), "perturbation": resolve_perturbation(cell.perturbation)}
        try:
            second = second_checkpoint(setup, cell.method, cell.perturbation)
        except ValueError as error:
            raise ValueError(f"{cell.title}: {error}") from error
        if second is not None:
            own["agent_flow"] = content(second)
        jobs[file] = Job(setup, cell, json.loads(json.dumps(own, default=str)))
    return list(jobs.values())


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


def row_file(folder: Path, cell: Cell, suffix: str = ".json") -> Path:
    """Where a cell's row lies, or what belongs to it under another suffix."""
    name = "__".join(part.replace("seed ", "seed") for part in cell.names)
    return folder / f"{re.sub(r'[^A-Za-z0-9_.=,+-]', '_', name)}{suffix}"


def make_row(job: Job, *, seconds: float, episodes: Sequence[Episode]) -> Row:
    """The row of a cell that has just been played on this machine."""
    return {
        "cell": asdict(job.cell),
        "conditions": job.conditions,
        "checkpoints": {"agent": job.setup.agent, "adapter": job.setup.adapter},
        "versions": versions(),
        "seconds": round(seconds, 3),
        "episodes": [asdict(episode) for episode in episodes],
    }


def write_row(folder: Path, row: Row) -> None:
    """Write a row: whatever happens, its file is there whole or not at all.

    Raises:
        OSError: If it cannot be written.
    """
    file = row_file(folder, Cell(**row["cell"]))
    temporary = file.with_name(f"{file.name}.part")
    try:
        with temporary.open("w") as opened:
            json.dump(row, opened, indent=1)
            opened.flush()
            os.fsync(opened.fileno())
        temporary.replace(file)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(file)) from error


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


def finished_cells(folder: Path, jobs: Sequence[Job]) -> set[Cell]:
    """Which of the planned cells have a row already.

    Raises:
        ValueError: If the folder holds rows that were made under other conditions.
    """
    shared: dict[str, Conditions] = {}
    lines: dict[tuple[str, str], Conditions] = {}
    columns: dict[tuple[str, str], Conditions] = {}
    both: dict[tuple[str, str, str], Conditions] = {}
    for job in jobs:
        task, own = job.cell.task, {key: value for key, value in job.conditions.items() if key not in SHARED}
        shared[task] = {key: job.conditions[key] for key in SHARED}
        lines[task, job.cell.line] = {"perturbation": own.pop("perturbation")}
        both[task, job.cell.line, job.cell.column] = {"agent_flow": own.pop("agent_flow", None)}
        columns[task, job.cell.column] = own
    done = set()
    for row in read_rows(folder):
        cell, there = Cell(**row["cell"]), row["conditions"]
        # Whatever stands in the same line or column of the report must have been made alike.
        here = {
            **shared.get(cell.task, {}),
            **lines.get((cell.task, cell.line), {}),
            **columns.get((cell.task, cell.column), {}),
            **both.get((cell.task, cell.line, cell.column), {}),
        }
        # What a column's rows were made with and it has no longer counts too.
        gone = there.keys() - {"perturbation", "agent_flow"} if (cell.task, cell.column) in columns else set()
        names = [*here, *sorted(gone - here.keys())]
        different = [f"{name}={there.get(name)}" for name in names if here.get(name) != there.get(name)]
        if different:
            raise ValueError(
                f"{folder} holds a row of {cell} made with {', '.join(different)}: "
                "choose another --output_dir, or delete that one"
            )
        done.add(cell)
    return done & {job.cell for job in jobs}
