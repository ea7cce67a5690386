"""The tables of a report, before they become Markdown or HTML."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lerobot_gloves.benchmark.cell import PERTURBED
from lerobot_gloves.report.paper import COLUMNS, SOURCE, Published, published
from lerobot_gloves.report.statistics import PairedDifference
from lerobot_gloves.report.summary import Result, Section, ranks
from lerobot_gloves.report.told import WHAT_IT_IS_TOLD, told
from lerobot_gloves.specification import NONE, name_of

MISSING = "–"
MARKS = "best and second best marked where all played the same episodes"
PAPER_LINES = f"Lines named published are the paper's own figures, from its table {SOURCE}."

type _Figures = dict[str, dict[str, Published]]
"""Lines of the paper's table: by perturbation, by method."""


@dataclass(frozen=True)
class Entry:
    """A table's cell: its text, and its rank in its line (1 best, 2 second best, else 0).

    The text is a line for what matters most, and below it what a narrow column has no room for beside it.
    """

    text: str
    rank: int = 0

    @property
    def in_one_line(self) -> str:
        """The whole text."""
        return self.text.replace("\n", " ")


@dataclass(frozen=True)
class Table:
    """A table: what it shows, its headers, and its lines of as many cells."""

    caption: str
    header: list[str]
    lines: list[list[Entry]]


def tables(section: Section, *, paper: bool = False) -> list[Table]:
    """All tables of a section.

    Args:
        section: What to tabulate.
        paper: Whether the paper's own lines stand beside ours.
    """
    corrected = [name for name in section.methods if name != section.raw]
    made = [success(section, paper=paper)]
    if section.raw is not None and corrected:
        made.append(differences(section, corrected))
    if any(result.chunks for result in section.results.values()):
        caption = (
            "Intervention rate: chunks edited; distance: mean of executed from proposed actions, "
            "in the adapter's normalised units."
        )
        made.append(_table(section, corrected, caption, edits))
        caption = "Cost of a chunk: milliseconds and network evaluations of the adapter, gate included."
        made.append(_table(section, corrected, caption, cost))
    if any(result.failures for result in section.results.values()):
        caption = "How episodes failed, in % of all episodes."
        made.append(_table(section, list(section.methods), caption, failures))
    return made


def success(section: Section, *, paper: bool) -> Table:
    """The main table: a line a perturbation, a column a method."""
    theirs = comparable(section) if paper else {}
    columns = _columns([section], paper=bool(theirs))
    deviation = "mean ± standard deviation over seeds" if section.seeds > 1 else "mean"
    caption = f"Success in %: {deviation} [95 % Wilson interval over all episodes{robust(section)}]; {MARKS}."
    if theirs:
        caption += f" {PAPER_LINES}"
    lines = [told_line([section], columns), *_success_lines(section, columns, theirs, success_text)]
    return Table(caption, ["perturbation", *columns], lines)


def differences(section: Section, columns: Sequence[str]) -> Table:
    """Every method's paired difference to the raw agent, with its interval and its p-value among all of them."""
    test = "sign-flip test by initial state" if section.states else "McNemar test"
    caption = (
        "Success minus the raw agent's in the same episodes, in points [95 % interval, Newcombe's for pairs"
        f"{robust(section)}], p of the exact {test}, Holm-corrected (comparisons in this table: "
        f"{len(section.corrected)})."
    )
    lines = []
    for perturbation in section.perturbations:
        line = [Entry(perturbation)]
        for name in columns:
            result, key = section.results.get((perturbation, name)), (perturbation, name)
            found = result and result.difference
            line.append(Entry(difference(found, section.corrected[key]) if found else MISSING))
        lines.append(line)
    return Table(caption, ["perturbation", *columns], lines)


def robust(section: Section) -> str:
    """What a caption says of intervals whose episodes are not independent; "" where they are."""
    return f", cluster-robust: the episodes share {section.states} initial states" if section.states else ""


def told_line(sections: Sequence[Section], columns: Sequence[str]) -> list[Entry]:
    """The line that says of each column what it is told of the fault."""

    def entry(column: str) -> Entry:
        known = {told(section.methods[column]) for section in sections if column in section.methods}
        return Entry(" or ".join(sorted(one or MISSING for one in known)) or MISSING)

    return [Entry(WHAT_IT_IS_TOLD), *map(entry, columns)]


def overview(sections: Sequence[Section], *, paper: bool) -> Table:
    """All tasks in one table, as the paper has them; its lines stand below each task's, once."""
    theirs = paper_lines(sections) if paper else {}
    columns = _columns(sections, paper=any(theirs.values()))
    head, *entries = told_line(sections, columns)
    lines = [[head, Entry(""), *entries]]
    for section in sections:
        name = f"{section.name}, {section.shared['split']}"
        figures = theirs.pop(section.task, {})
        lines += [[Entry(name), *line] for line in _success_lines(section, columns, figures, mean_text)]
    caption = f"Success in %: mean ± standard deviation over seeds; {MARKS}."
    if paper:
        caption += f" {PAPER_LINES}"
    return Table(caption, ["task", "perturbation", *columns], lines)


def comparable(section: Section) -> _Figures:
    """The paper's lines for the kinds of perturbation that a section has, in their order."""
    kinds = {name_of(written_out) for written_out in section.perturbations.values()}
    return {line: figures for line, figures in published(section.task).items() if name_of(line) in kinds}


def paper_lines(sections: Sequence[Section]) -> dict[str, _Figures]:
    """The paper's lines for several sections, by task."""
    lines: dict[str, _Figures] = {}
    for section in sections:
        lines[section.task] = lines.get(section.task, {}) | comparable(section)
    return lines


def _success_lines(
    section: Section, columns: Sequence[str], theirs: _Figures, text: Callable[[Result], str]
) -> list[list[Entry]]:
    """A section's lines, and below the last one of a kind the paper's."""

    def played(result: Result) -> str:
        """Says so where a benchmark is not finished."""
        fewer = f"\n({result.seeds} of {section.seeds} seeds)" if result.seeds < section.seeds else ""
        return text(result) + fewer

    lines = []
    kinds = [name_of(written_out) for written_out in section.perturbations.values()]
    for place, perturbation in enumerate(section.perturbations):
        lines.append([Entry(perturbation), *(_of(section, perturbation, name, played) for name in columns)])
        if kinds[place] not in kinds[place + 1 :]:
            lines += [
                _published_line(f"{specification}, published", columns, figures)
                for specification, figures in theirs.items()
                if name_of(specification) == kinds[place]
            ]
    return lines


def _columns(sections: Sequence[Section], *, paper: bool) -> list[str]:
    """The methods of several sections, and with `paper` all of the paper's, each once."""
    names = list(dict.fromkeys(name for section in sections for name in section.methods))
    if not paper:
        return names
    # The paper's columns in their order, ours of other names behind them.
    return [*COLUMNS, *(name for name in names if name not in COLUMNS)]


def _table(section: Section, columns: Sequence[str], caption: str, text: Callable[[Result], str]) -> Table:
    lines = [
        [Entry(perturbation), *(Entry(_of(section, perturbation, name, text).text) for name in columns)]
        for perturbation in section.perturbations
    ]
    return Table(caption, ["perturbation", *columns], lines)


def _of(section: Section, perturbation: str, name: str, text: Callable[[Result], str]) -> Entry:
    result = section.results.get((perturbation, name))
    return Entry(MISSING) if result is None else Entry(text(result), result.rank)


def _published_line(head: str, columns: Sequence[str], figures: dict[str, Published]) -> list[Entry]:
    order = ranks({name: figure.mean for name, figure in figures.items()})
    entries = [
        Entry(f"{100 * figures[name].mean:.1f} ± {100 * figures[name].deviation:.1f}", order[name])
        if name in figures
        else Entry(MISSING)
        for name in columns
    ]
    return [Entry(head), *entries]


def mean_text(result: Result) -> str:
    """Mean and deviation over seeds, in %."""
    deviation = "" if result.deviation is None else f" ± {100 * result.deviation:.1f}"
    return f"{100 * result.mean:.1f}{deviation}"


def success_text(result: Result) -> str:
    """The same, and the interval over episodes."""
    return f"{mean_text(result)}\n[{100 * result.low:.1f}, {100 * result.high:.1f}]"


def difference(found: PairedDifference, corrected: float) -> str:
    """The paired difference to another method, in points, and its corrected p-value."""
    p = f"p = {corrected:.3f}" if corrected >= 0.001 else "p < 0.001"
    return f"{100 * found.mean:+.1f}\n[{100 * found.low:+.1f}, {100 * found.high:+.1f}],\n{p}"


def edits(result: Result) -> str:
    """Intervention rate and distance."""
    if result.intervention is None or result.distance is None:
        return MISSING
    return f"{100 * result.intervention:.1f} %;\n{result.distance:.3f}"


def cost(result: Result) -> str:
    """Milliseconds and evaluations."""
    if result.milliseconds is None or result.evaluations is None:
        return MISSING
    return f"{result.milliseconds:.2f} ms;\n{result.evaluations:.1f}"


def failures(result: Result) -> str:
    """Failure kinds with their share of all episodes, in %."""
    return ",\n".join(f"{kind} {100 * n / result.episodes:.1f}" for kind, n in result.failures.items()) or "0"


def headline(section: Section) -> str:
    """A section's title."""
    return f"{section.name}, {section.shared['split']} split"


def facts(section: Section) -> str:
    """What the rows of a section have in common, in two sentences."""
    shared, seeds = section.shared, section.seeds
    env = ", ".join(f"{key}={value}" for key, value in shared["env"].items() if key != "type" and value is not None)
    return (
        f"{env}; {shared['episodes']} episodes for each of {seeds} {'seeds' if seeds > 1 else 'seed'}, "
        f"{shared['batch_size']} side by side. Agent {section.agent} ({shared['agent'][:12]})."
    )


def definitions(section: Section) -> list[str]:
    """What the lines and columns stand for where their names do not say it, in one line each."""
    told = [f"{name}: {written_out}" for name, written_out in section.perturbations.items() if ":" not in name]
    told = [definition for definition in told if definition != f"{NONE}: {NONE}"]
    for name, row in section.methods.items():
        own = row.conditions
        if row.cell.raw:
            continue
        scored = [f"score {own['score']}", f"alpha {own['alpha']}"] if own.get("score") else []
        adapter = f"adapter {row.checkpoints['adapter']} ({own['adapter'][:12]})"
        told.append(", ".join([f"{name}: {row.specification}", *scored, adapter, *described(own.get("options") or {})]))
    return told


def described(options: Mapping[str, Any]) -> list[str]:
    """What a method's adapter was told besides, an item an option; a method that knows the perturbation says so."""
    told = []
    for name, value in options.items():
        items = [f"{key} as {new}" for key, new in value.items()] if isinstance(value, Mapping) else value
        text = " ".join(map(str, items)) if isinstance(items, list) else str(items)
        knows = (
            f" (it is told the perturbation: {PERTURBED} is the name of the one played)" if PERTURBED in text else ""
        )
        told.append(f"{name} {text}{knows}")
    return told
