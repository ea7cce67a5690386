"""All tasks together: the paper's cells, one task and kind of perturbation each, and what a method has on average."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from statistics import fmean

from lerobot_gloves.report.clusters import variance
from lerobot_gloves.report.paper import COLUMNS, KINDS, published
from lerobot_gloves.report.statistics import Z_95, PairedDifference, holm
from lerobot_gloves.report.summary import Result, Section, compare, ranks
from lerobot_gloves.report.tables import MISSING, Entry, Table, told_line
from lerobot_gloves.specification import NONE

REFERENCES = (COLUMNS[0], "CSA")
"""What every method is compared with: the raw agent, and the strongest baseline."""
LEVEL = 0.05


@dataclass(frozen=True)
class Against:
    """A method's success minus another's over all cells, in the same episodes.

    Attributes:
        mean: Mean of the cells' differences, in points.
        low: Lower end of its 95 % interval, in points.
        high: Upper end.
        better: In how many cells the method is significantly better, all comparisons of the table corrected for.
        worse: In how many it is significantly worse.
    """

    mean: float
    low: float
    high: float
    better: int
    worse: int


@dataclass(frozen=True)
class Overall:
    """The tasks of a benchmark side by side.

    Attributes:
        sections: One a task.
    """

    sections: Sequence[Section]

    @property
    def cells(self) -> list[tuple[Section, str]]:
        """Task and kind of perturbation, a line each, in the paper's order; lines of other strengths are left out."""
        return [(section, kind) for section in self.sections for kind in KINDS if kind in section.perturbations]

    @property
    def methods(self) -> list[str]:
        """The paper's columns, and behind them what else was played on every task."""
        shared = set.intersection(*(set(section.methods) for section in self.sections))
        return [*COLUMNS, *(name for name in self.sections[0].methods if name in shared - set(COLUMNS))]

    def results(self, method: str) -> Iterator[Result]:
        """A method's, cell by cell."""
        for section, kind in self.cells:
            yield section.results[kind, method]

    def mean(self, method: str) -> float:
        """Mean success over the cells, in %."""
        return 100 * fmean(result.mean for result in self.results(method))

    def differences(self, method: str, other: str = COLUMNS[0]) -> list[PairedDifference]:
        """To another method, cell by cell, where they share episodes."""
        pairs = zip(self.results(other), self.results(method), strict=True)
        found = [compare(there.outcomes, here.outcomes) for there, here in pairs]
        return [one for one in found if one is not None]

    @cached_property
    def comparisons(self) -> dict[tuple[str, str], list[tuple[PairedDifference, float]]]:
        """Every method with each of `REFERENCES`, cell by cell: difference, and p-value Holm-corrected for them all."""
        pairs = [
            (method, other) for other in REFERENCES for method in self.methods if method not in (other, *REFERENCES)
        ]
        pairs.append((REFERENCES[1], REFERENCES[0]))  # once: the other way round it is the same comparison
        found = {pair: self.differences(*pair) for pair in pairs}
        corrected = iter(holm([one.p_value for several in found.values() for one in several]))
        return {pair: [(one, next(corrected)) for one in several] for pair, several in found.items()}

    def against(self, method: str, other: str) -> Against:
        """A method compared with one of `REFERENCES` over all cells.

        The interval is the normal one about the mean of the cells' differences. Tasks are independent, cells of one
        task are not: they begin with the same seeds. So its variance is summed over tasks, and inside one over initial
        states, each with its episodes under every perturbation.
        """
        mean = total = 0.0
        for section in self.sections:
            residuals, clusters = [], []
            for kind in [kind for here, kind in self.cells if here is section]:
                after, before = (section.results[kind, name].outcomes for name in (method, other))
                found = {one: int(after[one]) - int(before[one]) for one in after if one in before}
                middle = fmean(found.values())
                mean += middle / len(self.cells)
                residuals += [(value - middle) / len(found) / len(self.cells) for value in found.values()]
                clusters += [played.state for played in found]
            total += variance(residuals, clusters)
        mean, half = 100 * mean, 100 * Z_95 * sqrt(total)
        sure = [found.mean for found, corrected in self.comparisons[method, other] if corrected < LEVEL]
        better, worse = sum(found > 0 for found in sure), sum(found < 0 for found in sure)
        return Against(mean, mean - half, mean + half, better, worse)

    def gain(self, method: str, kind: str) -> float:
        """Mean over the tasks of a method's success minus the raw agent's under a kind of perturbation, in points."""
        sections = [section for section, here in self.cells if here == kind]
        means = [[section.results[kind, name].mean for section in sections] for name in (method, COLUMNS[0])]
        return 100 * (fmean(means[0]) - fmean(means[1]))

    def marks(self, section: Section, kind: str) -> dict[str, int]:
        """Ranks of a cell among `methods` alone: what else a task was played with takes no mark."""
        return ranks({method: section.results[kind, method].mean for method in self.methods})

    def leads(self, method: str) -> int:
        """In how many cells it is the best, or one of several."""
        return sum(self.marks(section, kind)[method] == 1 for section, kind in self.cells)

    @property
    def rescaled(self) -> int:
        """How many cells are not at the paper's strength."""
        return sum(section.perturbations[kind] not in published(section.task) for section, kind in self.cells)


def overall_table(overall: Overall, searched: Mapping[str, str]) -> Table:
    """Their mean and what it is worth first, then the means of all cells, and the unperturbed agents' last.

    Args:
        overall: The tasks.
        searched: By method, how many settings the search of each task tried.
    """
    columns, cells = overall.methods, len(overall.cells)
    means = {method: overall.mean(method) for method in columns}
    order = ranks(means)
    lines = [
        told_line(overall.sections, columns),
        [Entry("settings in each task's search"), *(Entry(searched.get(method, MISSING)) for method in columns)],
        [Entry(f"mean of {cells}"), *(Entry(f"{means[m]:.1f}", order[m]) for m in columns)],
    ]
    for other in REFERENCES:
        found = {method: overall.against(method, other) for method in columns if (method, other) in overall.comparisons}
        lines += [
            [Entry(f"mean minus {other}'s"), *(Entry(points(found[m]) if m in found else MISSING) for m in columns)],
            [
                Entry(f"cells better, worse than {other}"),
                *(Entry(f"{found[m].better}, {found[m].worse}" if m in found else MISSING) for m in columns),
            ],
        ]
    for section, kind in overall.cells:
        marks = overall.marks(section, kind)
        entries = [Entry(f"{100 * section.results[kind, method].mean:.1f}", marks[method]) for method in columns]
        lines.append([Entry(f"{section.name}, {kind}"), *entries])
    for section in overall.sections:
        results = [section.results[NONE, method] for method in columns]
        lines.append([Entry(f"{section.name}, nothing perturbed"), *(Entry(f"{100 * r.mean:.1f}") for r in results)])
    compared = sum(map(len, overall.comparisons.values()))
    caption = (
        "Success in %, mean over ten seeds; of the perturbed cells the best is bold and the second best italic. "
        "Differences are of the same episodes, in points [95 % interval, robust to initial states that they share]; a "
        f"cell is better or worse where the exact test has p < {LEVEL}, Holm-corrected (comparisons in this table: "
        f"{compared})."
    )
    return Table(caption, ["task, perturbation", *columns], lines)


def points(found: Against) -> str:
    """A mean difference and its interval."""
    return f"{found.mean:+.1f}\n[{found.low:+.1f}, {found.high:+.1f}]"
