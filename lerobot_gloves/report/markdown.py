"""Markdown tables."""

from lerobot_gloves.report.tables import Entry, Table
from lerobot_gloves.system.text import markdown_table


def markdown(table: Table) -> str:
    """A table below its caption; the best of a line is **bold**, the second best in _italics_."""
    return f"{table.caption}\n\n{markdown_table([table.header, *([_marked(e) for e in line] for line in table.lines)])}"


def _marked(entry: Entry) -> str:
    return ("{}", "**{}**", "_{}_")[entry.rank].format(entry.in_one_line)
