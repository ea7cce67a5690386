"""The paper's main table, to stand beside ours."""

import json
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from lerobot_gloves.specification import name_of

_TABLE = json.loads(Path(__file__).with_name("paper.json").read_text())

SOURCE: str = _TABLE["source"]
"""The table's label in the paper."""
COLUMNS: tuple[str, ...] = tuple(_TABLE["columns"])
"""The methods, in the paper's order; the first is the raw agent."""
KINDS = ("laggy", "noised", "slow", "shift")
"""The perturbations, in the paper's order."""


@dataclass(frozen=True)
class Published:
    """One figure of the paper: a mean success rate and its standard deviation over seeds, both in [0, 1]."""

    mean: float
    deviation: float


def published(task: str) -> dict[str, dict[str, Published]]:
    """The paper's lines for a task.

    Args:
        task: Its `--env.type`.

    Returns:
        By perturbation with the paper's strength, such as `laggy:p=0.2`, and by method; empty for other tasks.
    """
    return {
        perturbation: {
            method: Published(mean / 100, deviation / 100)
            for method, (mean, deviation) in zip(COLUMNS, figures, strict=True)
        }
        for perturbation, figures in _TABLE["tasks"].get(task, {}).items()
    }


def published_mean(method: str) -> float:
    """The paper's mean over its 16 cells, in %."""
    return 100 * fmean(line[method].mean for line in _lines())


def published_wins(method: str) -> int:
    """In how many of its 16 cells the paper has the method above the raw agent."""
    return sum(line[method].mean > line[COLUMNS[0]].mean for line in _lines())


def published_gain(method: str, kind: str) -> float:
    """The paper's mean of a method minus its raw agent over its tasks, under a kind of perturbation, in points."""
    return 100 * fmean(line[method].mean - line[COLUMNS[0]].mean for line in _lines(kind))


def _lines(kind: str = "") -> list[dict[str, Published]]:
    """The table's lines of all tasks, of one kind of perturbation or of all."""
    return [
        line
        for task in _TABLE["tasks"]
        for perturbation, line in published(task).items()
        if name_of(perturbation) == kind or not kind
    ]
