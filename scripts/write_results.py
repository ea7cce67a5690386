"""Write docs/results.md from the rows in docs/rows/: no figure in it is typed by hand.

A folder of docs/rows/ holds rows of `gloves bench` and a note.md that says how they came about; a JSON file is what
scripts/measure.py kept of one command.

    python scripts/write_results.py
"""

import argparse
import json
from pathlib import Path

from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.report.markdown import report_markdown

DOCS = Path(__file__).parents[1] / "docs"
HEAD = """# Results

Everything here was measured on two cores without a GPU, by the command that stands beside it. This page is written by
`python scripts/write_results.py` from `docs/rows/`.
"""


def benchmark(folder: Path) -> str:
    """One folder of benchmark rows, with the note beside it."""
    note = folder / "note.md"
    return "\n".join([note.read_text().strip(), "", report_markdown(read_rows(folder), paper=True).strip()])


def measurement(file: Path) -> str:
    """One command and what it printed."""
    found = json.loads(file.read_text())
    return f"## {found['title']}\n\n```console\n$ {found['command']}\n{found['printed']}\n```"


def main(output: Path = DOCS / "results.md") -> None:
    """Write the page."""
    rows = DOCS / "rows"
    sections = [benchmark(path) if path.is_dir() else measurement(path) for path in sorted(rows.iterdir())]
    output.write_text("\n\n".join([HEAD.strip(), *sections]) + "\n")


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    main()
