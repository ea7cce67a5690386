"""A row: a finished cell, with all that it takes to play it again, and the file that it is kept in."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lerobot_gloves.benchmark.alike import Conditions
from lerobot_gloves.benchmark.cell import Cell, gated, split_gate
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.system.files import whole


@dataclass(frozen=True, kw_only=True)
class Row:
    """A finished cell.

    Attributes:
        cell: Which one.
        conditions: What decided its episodes besides its seed, every option written out, checkpoints by content.
        checkpoints: Where agent and adapter came from.
        versions: Versions of Python and of the packages that an episode depends on.
        seconds: How long it took.
        episodes: What happened.
    """

    cell: Cell
    conditions: Conditions
    episodes: tuple[Episode, ...]
    checkpoints: dict[str, str | None] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def task(self) -> str:
        """The name that the task was given, or else its `--env.type`."""
        return self.cell.task or str(self.conditions["env"]["type"])

    @property
    def specification(self) -> str:
        """The editor with every option written out, and its gate."""
        return gated(self.conditions["editor"], self.conditions["gate"])

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "Row":
        """A row from what `to_json` made of it, or from a file of before cells knew their gate.

        Raises:
            KeyError: If something is missing.
            TypeError: If something is there that no row has.
        """
        cell, conditions = dict(content["cell"]), dict(content["conditions"])
        for where in (cell, conditions):
            if "method" in where:
                where["editor"], where["gate"] = split_gate(where.pop("method"))
        return cls(
            cell=Cell(**cell),
            conditions=conditions,
            episodes=tuple(Episode(**episode) for episode in content["episodes"]),
            **{key: content[key] for key in ("checkpoints", "versions", "seconds") if key in content},
        )

    def to_json(self) -> dict[str, Any]:
        """The row as JSON data."""
        return asdict(self)

    def save(self, folder: Path) -> None:
        """Write the row's file: whatever happens, it is there whole or not at all.

        Raises:
            OSError: If it cannot be written.
        """
        with whole(row_file(folder, self.cell)) as file:
            file.write_text(json.dumps(self.to_json(), indent=1))


def row_file(folder: Path, cell: Cell, suffix: str = ".json") -> Path:
    """Where a cell's row lies, or what belongs to it under another suffix."""
    name = "__".join(part.replace("seed ", "seed") for part in cell.names)
    return folder / f"{re.sub(r'[^A-Za-z0-9_.=,+-]', '_', name)}{suffix}"
