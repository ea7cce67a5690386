"""The plan of a run: every cell checked, with what decides its episodes written out."""

import functools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_gloves.benchmark.alike import Conditions, differences, parts
from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.row import row_file
from lerobot_gloves.benchmark.setup import Setup, agent_flow, resolve_method
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.evaluation.agent import resolve_perturbation


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

    @functools.cache
    def of_column(setup: Setup, editor: str, gate: bool) -> Conditions:
        config("agent", setup.agent)
        own = resolve_method(setup, editor, gate)
        shared = {
            "env": {
                "type": setup.env.type,
                "task": setup.env.task,
                **setup.env.gym_kwargs,
                **({"fast_rendering": True} if setup.fast_rendering else {}),
            },
            "agent": content(setup.agent),
            "split": setup.split,
            "episodes": setup.episodes,
            "batch_size": setup.batch_size,
        }
        return {**shared, **own, **({"adapter": content(setup.adapter)} if "score" in own else {})}

    @functools.cache
    def second_checkpoint(setup: Setup, editor: str, perturbation: str) -> str | None:
        return agent_flow(setup, Cell(perturbation, editor, 0))

    jobs: dict[Path, Job] = {}
    for setup, cell in matrix:
        file = row_file(Path(), cell)
        if file in jobs:
            raise ValueError(f"{jobs[file].cell} and {cell} have the same name: label them differently")
        own = {**of_column(setup, cell.editor, cell.gate), "perturbation": resolve_perturbation(cell.perturbation)}
        try:
            second = second_checkpoint(setup, cell.editor, cell.perturbation)
        except ValueError as error:
            raise ValueError(f"{cell.title}: {error}") from error
        if second is not None:
            own["agent_flow"] = content(second)
        jobs[file] = Job(setup, cell, json.loads(json.dumps(own, default=str)))
    return list(jobs.values())


def finished_cells(folder: Path, jobs: Sequence[Job]) -> set[Cell]:
    """Which of the planned cells have a row already.

    Raises:
        ValueError: If the folder holds rows that were made under other conditions.
    """
    planned: dict[tuple[str, ...], Conditions] = {}
    for job in jobs:
        planned.update(parts(job.cell, job.conditions))
    done = set()
    for row in read_rows(folder):
        # Whatever stands in the same line or column of the report must have been made alike.
        different = [
            difference
            for part, there in parts(row.cell, row.conditions)
            if part in planned
            for difference in differences(planned[part], there)
        ]
        if different:
            raise ValueError(
                f"{folder} holds a row of {row.cell} made with {', '.join(different)}: "
                "choose another --output_dir, or delete that one"
            )
        done.add(row.cell)
    return done & {job.cell for job in jobs}
