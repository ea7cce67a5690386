"""Markdown tables."""

from collections.abc import Sequence

from lerobot_gloves.report.tables import Entry, Table


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table of lines of equally many cells, headers first; its columns line up in a terminal as well."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    padded = [[text.ljust(width) for text, width in zip(line, widths, strict=True)] for line in lines]
    padded.insert(1, ["-" * width for width in widths])
    return "\n".join(f"| {' | '.join(line)} |" for line in padded)


def markdown(table: Table) -> str:
    """A table below its caption; the best of a line is **bold**, the second best in _italics_."""
    return f"{table.caption}\n\n{markdown_table([table.header, *([_marked(e) for e in line] for line in table.lines)])}"


def _marked(entry: Entry) -> str:
    return ("{}", "**{}**", "_{}_")[entry.rank].format(entry.in_one_line)
