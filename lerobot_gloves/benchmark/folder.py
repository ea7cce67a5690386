"""A folder of rows: one JSON file a row, or all of them in one compressed file."""

import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.row import Row, row_file
from lerobot_gloves.system.files import whole

PACKED = "rows.jsonl.gz"
"""The compressed file: a row a line."""


def read_rows(folder: Path) -> list[Row]:
    """All rows of a folder, packed or not, in the order of their cells' files.

    Raises:
        ValueError: If a file is not a row.
    """
    rows: dict[Cell, Row] = {}
    for file, content in _contents(folder):
        try:
            row = Row.from_json(content)
        except (KeyError, TypeError) as error:
            raise ValueError(f"{file} is not a row of gloves bench: {error}") from error
        rows[row.cell] = row  # one that was played anew goes before the one that was packed
    return sorted(rows.values(), key=lambda row: row_file(folder, row.cell))


def pack(rows: Sequence[Row], folder: Path) -> Path:
    """Write rows as one compressed file of a folder, the same bytes whenever; `read_rows` reads it like their own.

    Raises:
        OSError: If it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = "".join(json.dumps(row.to_json(), separators=(",", ":")) + "\n" for row in rows)
    with whole(folder / PACKED) as file:
        file.write_bytes(gzip.compress(lines.encode(), mtime=0))
    return folder / PACKED


def _contents(folder: Path) -> Iterator[tuple[Path, Any]]:
    """What files of a folder hold, the packed one first."""
    packed = folder / PACKED
    try:
        if packed.exists():
            file = packed
            lines = gzip.decompress(packed.read_bytes()).decode().splitlines()
            if not lines:
                raise EOFError("it is empty")
            for line in lines:
                yield file, json.loads(line)
        for file in sorted(folder.glob("*.json")):
            yield file, json.loads(file.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError, EOFError, OSError) as error:
        raise ValueError(f"{file} is not a row of gloves bench: {error}") from error
