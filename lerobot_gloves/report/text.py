"""Rows to Markdown: success, difference to the raw agent, edits, cost and failures."""

from collections.abc import Sequence

from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.report.markdown import markdown
from lerobot_gloves.report.summary import Section, summarise
from lerobot_gloves.report.tables import definitions, facts, headline, overview, tables


def report(rows: Sequence[Row], *, paper: bool = False) -> str:
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
