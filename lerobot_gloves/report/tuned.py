"""Settings that were chosen without a simulator beside those that a search found, in the same episodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from lerobot_gloves.report.paper import COLUMNS, KINDS
from lerobot_gloves.report.summary import Section, compare
from lerobot_gloves.report.tables import MISSING, Entry, Table
from lerobot_gloves.specification import NONE

SEARCHED = "FEEG+gate"
"""The column of a search's choice for an expert flow."""


@dataclass(frozen=True)
class Pair:
    """A task, played with the search's choice and, in the same episodes, with another one for the same adapter.

    Attributes:
        searched: The task's own rows, the raw agent's among them.
        tuned: Those of one method, whatever its name.

    Raises:
        ValueError: If the two share no episodes, are of other agents, or the second holds several methods.
    """

    searched: Section
    tuned: Section

    def __post_init__(self) -> None:
        if len(self.tuned.methods) != 1:
            raise ValueError(f"{self.tuned.name}: expected the rows of one method, but there are {self.tuned.methods}")
        if (self.tuned.name, self.tuned.shared["agent"]) != (self.searched.name, self.searched.shared["agent"]):
            raise ValueError(f"{self.tuned.name}: its rows are of another task or agent than {self.searched.name}'s")

    @property
    def kinds(self) -> list[str]:
        """The paper's perturbations that both were played under."""
        return [
            kind for kind in KINDS if (kind, SEARCHED) in self.searched.results and kind in self.tuned.perturbations
        ]

    def success(self, kind: str) -> tuple[float, float, float]:
        """Success of the raw agent, of the search's choice and of the other one, in %."""
        [method] = self.tuned.methods
        results = [self.searched.results[kind, COLUMNS[0]], self.searched.results[kind, SEARCHED]]
        raw, searched, tuned = (100 * one.mean for one in (*results, self.tuned.results[kind, method]))
        return raw, searched, tuned

    @property
    def unperturbed(self) -> str:
        """What the second choice costs an agent that nothing perturbs, in points, with its 95 % interval."""
        [method] = self.tuned.methods
        found = compare(self.searched.results[NONE, COLUMNS[0]].outcomes, self.tuned.results[NONE, method].outcomes)
        if found is None:
            raise ValueError(f"{self.tuned.name}: the raw agent and {method} share no episode")
        return f"{100 * found.mean:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"


def share(pairs: Sequence[Pair]) -> float:
    """What the second choices gain over the raw agents, as a share in % of what the searches' gain, over all cells."""
    raw, searched, tuned = (fmean(column) for column in zip(*_cells(pairs), strict=True))
    return 100 * (tuned - raw) / (searched - raw)


def tuned_table(pairs: Sequence[Pair]) -> Table:
    """A line a task, one for all cells, and behind each cell's success what an unperturbed agent is cost."""

    def line(name: str, cells: Sequence[str], of: Sequence[Pair], unperturbed: str) -> list[Entry]:
        mean = _text([fmean(column) for column in zip(*_cells(of), strict=True)])
        return [Entry(text) for text in (name, *cells, mean, f"{share(of):.0f} %", unperturbed)]

    lines = []
    for pair in pairs:
        cells = [_text(pair.success(kind)) if kind in pair.kinds else MISSING for kind in KINDS]
        lines.append(line(pair.searched.name, cells, [pair], pair.unperturbed))
    lines.append(line(f"all {len(_cells(pairs))} cells", [""] * len(KINDS), pairs, ""))
    return Table(
        caption=f"Success in %: raw agent / {SEARCHED} as its search chose it / as gloves tune did, the same episodes.",
        header=["task", *KINDS, "mean", "share of the gain", "none: tuned minus raw"],
        lines=lines,
    )


def _text(success: Sequence[float]) -> str:
    return " / ".join(f"{value:.1f}" for value in success)


def _cells(pairs: Sequence[Pair]) -> list[tuple[float, float, float]]:
    return [pair.success(kind) for pair in pairs for kind in pair.kinds]
