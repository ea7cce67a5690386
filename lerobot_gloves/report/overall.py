"""All tasks together: the paper's cells, one task and kind of perturbation each, and what a method has on average."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean

from lerobot_gloves.report.paper import COLUMNS, KINDS, published
from lerobot_gloves.report.statistics import PairedDifference
from lerobot_gloves.report.summary import Result, Section, ranks
from lerobot_gloves.report.tables import Entry, Table
from lerobot_gloves.specification import NONE


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

    def differences(self, method: str) -> list[PairedDifference]:
        """To the raw agent, cell by cell."""
        return [result.difference for result in self.results(method) if result.difference is not None]

    def gain(self, method: str, kind: str) -> float:
        """Mean over the tasks of a method's success minus the raw agent's under a kind of perturbation, in points."""
        sections = [section for section, here in self.cells if here == kind]
        means = [[section.results[kind, name].mean for section in sections] for name in (method, COLUMNS[0])]
        return 100 * (fmean(means[0]) - fmean(means[1]))

    def ahead(self, method: str, other: str) -> int:
        """In how many cells a method has more success than another."""
        return sum(one.mean > two.mean for one, two in zip(self.results(method), self.results(other), strict=True))

    def behind_the_best(self, method: str) -> float:
        """By how many points it is behind the best method of a cell where it is furthest behind."""
        best = [max(section.results[kind, name].mean for name in self.methods) for section, kind in self.cells]
        return 100 * max(most - result.mean for most, result in zip(best, self.results(method), strict=True))

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


def overall_table(overall: Overall) -> Table:
    """Means of all cells, their mean below them, and the unperturbed agents' last."""
    lines, columns = [], overall.methods
    for section, kind in overall.cells:
        marks = overall.marks(section, kind)
        entries = [Entry(f"{100 * section.results[kind, method].mean:.1f}", marks[method]) for method in columns]
        lines.append([Entry(f"{section.name}, {kind}"), *entries])
    means = {method: overall.mean(method) for method in columns}
    order = ranks(means)
    lines.append([Entry(f"mean of {len(overall.cells)}"), *(Entry(f"{means[m]:.1f}", order[m]) for m in columns)])
    for section in overall.sections:
        results = [section.results[NONE, method] for method in columns]
        lines.append([Entry(f"{section.name}, nothing perturbed"), *(Entry(f"{100 * r.mean:.1f}") for r in results)])
    caption = "Success in %, mean over ten seeds; of the perturbed cells the best is bold and the second best italic."
    return Table(caption, ["task, perturbation", *columns], lines)
