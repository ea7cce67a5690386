"""Rows of a benchmark, made by hand, as the JSON of before cells knew their gate: all who load them test that too."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.plan import Job, plan
from lerobot_gloves.benchmark.play import make_row
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.evaluation.episode import Episode

SHARED = {
    "env": {"type": "gloves_slalom", "task": "Slalom-v0", "obs_type": "state", "mode": None},
    "agent": "a" * 64,
    "split": "test",
    "episodes": 4,
    "batch_size": 4,
}


def row(perturbation: str, method: str, seed: int, successes: list[int], **facts: Any) -> dict[str, Any]:
    """A row whose episodes succeed as told; the facts are every episode's."""
    own = {} if method == "none" else {"score": "reverse:steps=1", "alpha": 0.05, "adapter": "b" * 64}
    episodes = [
        {"seed": 10000 + 100 * seed + i, "success": bool(s), "failure": "" if s else "collision", "steps": 50, **facts}
        for i, s in enumerate(successes)
    ]
    return {
        "cell": {"perturbation": perturbation, "method": method, "seed": seed},
        "conditions": {**SHARED, "perturbation": perturbation, "method": method, **own},
        "checkpoints": {"agent": "my/agent", "adapter": "my/adapter"},
        "episodes": episodes,
    }


def labelled(row: dict[str, Any], **cell: str) -> dict[str, Any]:
    """The same row with names in its cell."""
    return row | {"cell": row["cell"] | cell}


ROWS = [
    row("slow", "feeg+gate", 1, [1, 1, 1, 0], chunks=10, edited=2, distance=0.1, milliseconds=3.0, evaluations=5.0),
    row("slow", "feeg+gate", 0, [1, 1, 0, 0], chunks=5, edited=4, distance=0.4, milliseconds=6.0, evaluations=11.0),
    row("slow", "none", 0, [0, 1, 0, 0]),
    row("slow", "none", 1, [0, 0, 1, 0]),
    row("none", "none", 0, [1, 1, 1, 1]),
]


def loaded(rows: Sequence[dict[str, Any]]) -> list[Row]:
    """The rows as `read_rows` gives them."""
    return [Row.from_json(row) for row in rows]


def planned(setup: Setup, *cells: Cell) -> list[Job]:
    """The jobs of cells with one setup."""
    return plan((setup, cell) for cell in cells)


def write(folder: Path, setup: Setup, cell: Cell) -> None:
    """The row of a cell of two failed episodes that nobody has played."""
    (job,) = planned(setup, cell)
    make_row(job, seconds=1.0, episodes=[Episode(10000), Episode(10001)]).save(folder)
