"""What must have been made alike to stand in one line or column of a table."""

from collections.abc import Iterator
from typing import Any

from lerobot_gloves.benchmark.cell import Cell

type Conditions = dict[str, Any]
"""What decides a cell's episodes besides its seed."""

SHARED = ("env", "agent", "split", "episodes", "batch_size")
"""The conditions that all rows of a task have in common, so that they can be compared."""


def shared(conditions: Conditions) -> Conditions:
    """Those of the conditions that all rows of a task have in common."""
    return {key: conditions.get(key) for key in SHARED}


def parts(cell: Cell, conditions: Conditions) -> Iterator[tuple[tuple[str, ...], Conditions]]:
    """A cell's conditions by the part of the table that they decide: its task, line, column, and both of these.

    The perturbation is a line's; a method that is told the perturbation may have a second checkpoint for each; all else
    is the column's.
    """
    own = {key: value for key, value in conditions.items() if key not in SHARED}
    perturbation, agent_flow = own.pop("perturbation", None), own.pop("agent_flow", None)
    yield (cell.task,), shared(conditions)
    yield (cell.task, "line", cell.line), {"perturbation": perturbation}
    yield (cell.task, "column", cell.column), own
    yield (cell.task, "both", cell.line, cell.column), {"agent_flow": agent_flow}


def differences(here: Conditions, there: Conditions) -> list[str]:
    """The conditions that differ, as `name=value` of those there."""
    names = [*here, *sorted(there.keys() - here.keys())]
    return [f"{name}={there.get(name)}" for name in names if here.get(name) != there.get(name)]
