"""`gloves report`: the tables of a benchmark from its rows."""

from dataclasses import dataclass
from pathlib import Path

from lerobot.configs import parser

from lerobot_gloves.benchmark.report import report
from lerobot_gloves.benchmark.rows import read_rows
from lerobot_gloves.commands.errors import one_line_errors


@dataclass
class ReportConfig:
    """Turn the rows that gloves bench left into Markdown tables."""

    # Folder of the rows.
    rows: Path
    # File to write the tables to, besides printing them.
    output: Path | None = None


@parser.wrap()
def write_report(config: ReportConfig) -> None:
    """Print the tables of a benchmark, and write them if asked."""
    if not config.rows.is_dir():
        raise FileNotFoundError(f"{config.rows} is no folder: --rows takes the --output_dir of gloves bench")
    text = report(read_rows(config.rows))
    print(text, end="")
    if config.output is not None:
        config.output.parent.mkdir(parents=True, exist_ok=True)
        config.output.write_text(text)


def main() -> None:
    """Entry point."""
    with one_line_errors("gloves report"):
        write_report()
