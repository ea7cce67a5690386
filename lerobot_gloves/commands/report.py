"""`gloves report`: the tables and plots of a benchmark from its rows."""

from dataclasses import dataclass
from pathlib import Path

from lerobot.configs import parser

from lerobot_gloves.benchmark.folder import pack, read_rows
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.report.csv_file import report_csv
from lerobot_gloves.report.markdown import report_markdown
from lerobot_gloves.system.files import write_text


@dataclass
class ReportConfig:
    """Turn the rows that gloves bench left into tables and plots.

    gloves report --rows=outputs/bench/first --html=report.html
    gloves report --rows='[outputs/bench/slalom, outputs/bench/keypad]' --paper=true --csv=figures.csv
    """

    # Folder of the rows, or several: '[FOLDER, FOLDER]'.
    rows: Path | list[Path]
    # File to write the Markdown tables to, besides printing them.
    output: Path | None = None
    # File for the same figures as CSV.
    csv: Path | None = None
    # File for one HTML page with tables and plots, which needs no other file.
    html: Path | None = None
    # Folder to write the same rows to as one compressed file, which reads like the rows' own.
    pack: Path | None = None
    # Whether the paper's own figures stand beside ours.
    paper: bool = False


@parser.wrap()
def write_report(config: ReportConfig) -> None:
    """Print the tables of a benchmark, and write what is asked for."""
    folders = config.rows if isinstance(config.rows, list) else [config.rows]
    for folder in folders:
        if not folder.is_dir():
            raise FileNotFoundError(f"{folder} is no folder: --rows takes the --output_dir of gloves bench")
    rows = [row for folder in folders for row in read_rows(folder)]
    text = report_markdown(rows, paper=config.paper)
    print(text, end="")
    if config.output is not None:
        write_text(config.output, text)
    if config.csv is not None:
        write_text(config.csv, report_csv(rows, paper=config.paper))
    if config.pack is not None:
        pack(rows, config.pack)
    if config.html is not None:
        from lerobot_gloves.report.html_page import report_html  # matplotlib takes a second to import

        write_text(config.html, report_html(rows, paper=config.paper))


def main() -> None:
    """Entry point."""
    with one_line_errors("gloves report"):
        write_report()
