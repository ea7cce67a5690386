"""The copilot beside the agents that it corrects, on all tasks, and beside the best of the other columns."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from lerobot_gloves.report.paper import COLUMNS, KINDS
from lerobot_gloves.report.summary import Result, Section
from lerobot_gloves.report.tables import MISSING, Entry, Table
from lerobot_gloves.specification import NONE

OURS = "copilot"


@dataclass(frozen=True)
class Beside:
    """A task.

    Attributes:
        played: The rows of the raw agent and, in the same episodes, of the copilot, and of other columns that are.
        table: Those of the other columns. Their agent may be another training.
    """

    played: Section
    table: Section

    @property
    def kinds(self) -> list[str]:
        """The paper's perturbations that it was played under."""
        return [kind for kind in KINDS if kind in self.played.perturbations]

    @property
    def same_agent(self) -> bool:
        """Whether both are of one training of the agent."""
        return bool(self.played.shared["agent"] == self.table.shared["agent"])

    def result(self, kind: str, method: str) -> Result:
        """Of a column: beside the copilot if it was played there, else beside the other agent."""
        return (self.played if (kind, method) in self.played.results else self.table).results[kind, method]

    def best(self, kind: str) -> tuple[str, float]:
        """The best of the other columns and its success in %."""
        success = {name: 100 * self.result(kind, name).mean for name in COLUMNS}
        name = max(success, key=lambda one: success[one])
        return name, success[name]


@dataclass(frozen=True)
class AllBeside:
    """All tasks.

    Attributes:
        tasks: One after another.
    """

    tasks: Sequence[Beside]

    def cells(self) -> Iterator[tuple[Beside, str, Result]]:
        """Task, kind of perturbation and what the copilot has."""
        for task in self.tasks:
            for kind in task.kinds:
                yield task, kind, task.played.results[kind, OURS]

    @property
    def count(self) -> int:
        """How many cells there are."""
        return len(list(self.cells()))

    def mean(self, method: str) -> float:
        """Mean success over the cells in %: of what was played beside the copilot, else of the other columns."""
        return 100 * fmean(task.result(kind, method).mean for task, kind, _ in self.cells())

    def ahead(self, method: str) -> int:
        """In how many cells the copilot has more success than another column."""
        return sum(ours.mean > task.result(kind, method).mean for task, kind, ours in self.cells())

    @property
    def leads(self) -> int:
        """In how many cells it is at least as good as every other column."""
        return sum(100 * ours.mean >= task.best(kind)[1] for task, kind, ours in self.cells())

    @property
    def furthest(self) -> float:
        """By how many points it is behind the best of the others where it is furthest behind; negative for nowhere."""
        return max(task.best(kind)[1] - 100 * ours.mean for task, kind, ours in self.cells())

    @property
    def above_raw(self) -> int:
        """In how many cells the interval of corrected minus raw lies above 0."""
        return sum(ours.difference is not None and ours.difference.low > 0 for _, _, ours in self.cells())

    @property
    def lowest_unperturbed(self) -> dict[str, float]:
        """By task, the lower end of the interval of corrected minus raw where nothing is perturbed, in points."""
        found = {task.played.name: task.played.results[NONE, OURS].difference for task in self.tasks}
        return {name: 100 * one.low for name, one in found.items() if one is not None}

    def table(self) -> Table:
        """A line a cell: raw agent, copilot, their difference in the same episodes, and the best of the others."""

        def line(task: Beside, kind: str, name: str) -> list[Entry]:
            ours, raw = (task.played.results[kind, method] for method in (OURS, COLUMNS[0]))
            column, success = task.best(kind)
            found = ours.difference
            assert found is not None  # they are played in the same episodes
            difference = f"{100 * found.mean:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"
            values = (f"{100 * raw.mean:.1f}", f"{100 * ours.mean:.1f}", difference, f"{success:.1f} ({column})")
            return [Entry(text) for text in (f"{task.played.name}, {name}", *values)]

        means = (f"{self.mean(COLUMNS[0]):.1f}", f"{self.mean(OURS):.1f}")
        difference = f"{self.mean(OURS) - self.mean(COLUMNS[0]):+.1f}"
        best = max(COLUMNS[1:], key=self.mean)
        lines = [
            [Entry(text) for text in (f"mean of {self.count}", *means, difference, f"{self.mean(best):.1f} ({best})")],
            *(line(task, kind, kind) for task in self.tasks for kind in task.kinds),
            *(line(task, NONE, "nothing perturbed") for task in self.tasks),
        ]
        caption = (
            "Success in %, mean over ten seeds; copilot minus raw agent in the same episodes, in points [95 % "
            "interval, robust to initial states that they share]; the best of the other columns."
        )
        others = [task for task in self.tasks if not task.same_agent]
        if others:
            beside = [name for name in COLUMNS[1:] if all((NONE, name) in task.played.results for task in others)]
            names = ", ".join(task.played.name for task in others)
            more = {
                task.played.name: [name for name in COLUMNS[1:] if (NONE, name) in task.played.results]
                for task in others
            }
            also = [f"{name}'s {column}" for name, found in more.items() for column in found if column not in beside]
            caption += (
                f" On {names} those of the table above are of another training of the agent by the same command"
                + (f", but {' and '.join([*beside, *also])} of the copilot's." if beside or also else ".")
            )
        return Table(caption, ["task, perturbation", COLUMNS[0], OURS, "copilot minus raw", "best other column"], lines)


def natural_table(sections: Mapping[str, Section], others: Mapping[str, Section]) -> Table:
    """Agents that nobody perturbs and that are imperfect all the same, a line each, and the means.

    Args:
        sections: By what it is called, of each agent the rows of itself and of one method that corrects it.
        others: The same agents' rows of other columns, as far as they were played.
    """
    beside = [name for name in COLUMNS[1:] if any(name in one.methods for one in others.values())]
    lines, gains = [], []
    for title, section in sections.items():
        [corrected] = [name for name in section.methods if name != COLUMNS[0]]
        raw, ours = (section.results[NONE, name] for name in (COLUMNS[0], corrected))
        found = ours.difference
        assert found is not None  # they are played in the same episodes
        gains.append(100 * found.mean)
        played = {} if title not in others else others[title].results
        theirs = [played.get((NONE, name)) for name in beside]
        difference = f"{gains[-1]:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"
        lines.append([title, *map(_percent, (raw, *theirs, ours)), difference])
    means = [_mean([line[column] for line in lines]) for column in range(1, len(beside) + 3)]
    lines.append(["mean", *means, f"{fmean(gains):+.1f}"])
    return Table(
        "Agents that nobody perturbs and that are imperfect by nature: success in %, mean over ten seeds; copilot "
        "minus raw agent in the same episodes, in points [95 % interval]."
        + (
            " The other columns have the settings that their searches chose for the perturbed agents." if beside else ""
        ),
        ["agent", "raw", *beside, "copilot", "copilot minus raw"],
        [[Entry(text) for text in line] for line in lines],
    )


def _percent(result: Result | None) -> str:
    return MISSING if result is None else f"{100 * result.mean:.1f}"


def _mean(percents: list[str]) -> str:
    """Of a column that has no gap."""
    return MISSING if MISSING in percents else f"{fmean(map(float, percents)):.1f}"
