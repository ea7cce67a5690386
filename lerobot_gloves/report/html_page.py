"""Rows to one HTML page that needs nothing but itself: tables, and plots as inline SVG."""

import io
import re
from collections.abc import Sequence
from html import escape

import matplotlib
from matplotlib.figure import Figure

from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.report.plots import INK, MOST_METHODS, STYLE, plots
from lerobot_gloves.report.summary import Section, summarise
from lerobot_gloves.report.tables import Entry, Table, definitions, facts, headline, overview, tables

CSS = """
:root { color-scheme: light dark;
  --ink: #1c1e21; --faint: #5c636b; --page: #ffffff; --line: #d5d8dc; --best: #cfe3fb; --second: #d5f0dc; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e6e9; --faint: #a3abb5; --page: #16181b; --line: #3a3e44; --best: #1d4674; --second: #1f5232; }
}
body { margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: var(--ink); background: var(--page);
  font: 15px/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
ul { padding-left: 1.2rem; font-size: 13px; }
figure { margin: 2rem 0; } figcaption { padding: .4rem 0; }
.wide { overflow-x: auto; }
.wide svg { display: block; width: 100%; min-width: 44rem; height: auto; color: var(--ink); }
table { border-collapse: separate; border-spacing: 0; font-variant-numeric: tabular-nums; font-size: 13px;
  line-height: 1.35; white-space: nowrap; overflow-wrap: normal; }
th, td { text-align: left; vertical-align: top; padding: .35rem; border-bottom: 1px solid var(--line); }
tr > :first-child { position: sticky; left: 0; min-width: 7.5rem; background: var(--page);
  white-space: normal; overflow-wrap: break-word; }
tbody th { font-weight: 400; }
td small { display: block; font-size: 11px; color: var(--faint); }
.best { background: var(--best); font-weight: 600; } .second { background: var(--second); }
.best small, .second small { color: inherit; font-weight: 400; }
@media (max-width: 75rem) { table { font-size: 12px; } td small { font-size: 10.5px; } th, td { padding: .3rem; } }
@media (max-width: 40rem) {
  body { margin: 1rem auto; padding: 0 .75rem; }
  tr > :first-child { min-width: 6rem; max-width: 6rem; border-right: 1px solid var(--line); }
}
""".strip()
CLASSES = ("", ' class="best"', ' class="second"')


def report_html(rows: Sequence[Row], *, paper: bool = False) -> str:
    """The page: the tables of `report`, and the plots of each section.

    Args:
        rows: What `gloves bench` left.
        paper: Whether the paper's own figures stand beside ours.

    Raises:
        ValueError: If there are no rows, or they contradict each other.
    """
    sections = summarise(rows)
    parts = ["<h1>gloves bench</h1>"]
    if len(sections) > 1:
        links = "".join(
            f'<li><a href="#section-{i}">{escape(headline(section))}</a></li>' for i, section in enumerate(sections)
        )
        parts += [f"<ul>{links}</ul>", table_html(overview(sections, paper=paper))]
    parts += [_section(section, i, paper=paper) for i, section in enumerate(sections)]
    return document("gloves bench", parts)


def document(title: str, parts: Sequence[str]) -> str:
    """A page of parts that are HTML already; the title is text."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{CSS}\n</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _section(section: Section, number: int, *, paper: bool) -> str:
    defined = "".join(f"<li>{escape(line)}</li>" for line in definitions(section))
    main, *others = tables(section, paper=paper)
    figures = [figure_html(caption, figure) for caption, figure in plots(section, paper=paper).items()]
    if not figures:
        figures = [
            f"<p>No plots: {len(section.methods)} methods are more than the {MOST_METHODS} that one can tell.</p>"
        ]
    return "\n".join(
        [
            f'<section id="section-{number}">\n<h2>{escape(headline(section))}</h2>\n<p>{escape(facts(section))}</p>',
            f"<ul>{defined}</ul>",
            table_html(main),
            *figures,
            *map(table_html, others),
            "</section>",
        ]
    )


def table_html(table: Table) -> str:
    """A table below its caption."""

    def line(entries: Sequence[Entry]) -> str:
        head, *others = entries
        cells = "".join(f"<td{CLASSES[entry.rank]}>{_broken(entry.text)}</td>" for entry in others)
        return f'<tr><th scope="row">{_breakable(head.text)}</th>{cells}</tr>'

    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
    body = "\n".join(line(entries) for entries in table.lines)
    return (
        f"<figure>\n<figcaption>{escape(table.caption)}</figcaption>\n"
        f'<div class="wide" tabindex="0"><table aria-label="{escape(table.caption)}">\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>\n</figure>"
    )


def _breakable(name: str) -> str:
    """A name with places at which a narrow column may break it: behind the marks of a specification."""
    return re.sub(r"([:,=])(?=\S)", r"\1<wbr>", escape(name))


def _broken(text: str) -> str:
    """An entry's first line, and the others below it in small type, where nothing needs to hold them together."""
    first, *others = (escape(line.rstrip(",;")) for line in text.split("\n"))
    return first + "".join(f"<small>{line}</small>" for line in others)


def figure_html(caption: str, figure: Figure) -> str:
    """A figure above its caption, which gets a full stop."""
    drawn = f'<div class="wide" tabindex="0">\n{svg(figure, caption)}\n</div>'
    return f"<figure>\n{drawn}\n<figcaption>{escape(caption)}.</figcaption>\n</figure>"


def svg(figure: Figure, label: str, *, page: bool = True) -> str:
    """A figure as an SVG element.

    Args:
        figure: What is drawn.
        label: What a screen reader says of it.
        page: Whether it stands in a page whose text colour it takes over, not in a file of its own on white paper.
    """
    file = io.StringIO()
    with matplotlib.rc_context(STYLE):
        # No date and no address of who made it, so that the same rows make the same page.
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        figure.savefig(file, format="svg", metadata=nothing, facecolor="none" if page else "white")
    text = file.getvalue()
    text = text[text.index("<svg") :]
    if page:
        text = text.replace(INK, "currentColor")
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Names of groups, the same in every figure; what is referred to (clip paths, markers) has unique ones.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1).strip()
