"""Rows to Markdown: success, difference to the raw agent, edits, cost and failures."""

from collections.abc import Sequence

from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.report.summary import Section, summarise
from lerobot_gloves.report.tables import Entry, Table, definitions, facts, headline, overview, tables
from lerobot_gloves.system.text import markdown_table


def report_markdown(rows: Sequence[Row], *, paper: bool = False) -> str:
    """The tables of a benchmark, one line a perturbation and one column a method.

    Args:
        rows: What `gloves bench` left, of one task or several.
        paper: Whether the paper's own lines stand beside ours.

    Raises:
        ValueError: If there are no rows, or they contradict each other.
    """
    sections = summarise(rows)
    parts = ["## All tasks", markdown(overview(sections, paper=paper))] if len(sections) > 1 else []
    for section in sections:
        parts += _section(section, paper=paper)
    return "\n\n".join(parts) + "\n"


def _section(section: Section, *, paper: bool) -> list[str]:
    defined = "\n".join(f"- {line}" for line in definitions(section))
    tabulated = [markdown(table) for table in tables(section, paper=paper)]
    return [f"## {headline(section)}", facts(section), *([defined] if defined else []), *tabulated]


def markdown(table: Table) -> str:
    """A table below its caption; the best of a line is **bold**, the second best in _italics_."""
    return f"{table.caption}\n\n{markdown_table([table.header, *([_marked(e) for e in line] for line in table.lines)])}"


def _marked(entry: Entry) -> str:
    return ("{}", "**{}**", "_{}_")[entry.rank].format(entry.in_one_line)
