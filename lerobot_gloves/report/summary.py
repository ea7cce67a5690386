"""Rows to figures: what the report says of each perturbation with each method."""

import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, stdev
from typing import Any

from lerobot_gloves.benchmark.cell import NONE
from lerobot_gloves.benchmark.row import SHARED, Row
from lerobot_gloves.evaluation import histogram
from lerobot_gloves.evaluation.rollout import Episode
from lerobot_gloves.report.paper import COLUMNS, KINDS
from lerobot_gloves.report.statistics import PairedDifference, paired_difference, wilson

AGENT = COLUMNS[0]

type Episodes = dict[tuple[int, int], Episode]
"""Episodes of one perturbation and method, by the policies' seed and the environment's."""


@dataclass(frozen=True)
class Result:
    """One perturbation with one method. Rates lie in [0, 1].

    Attributes:
        seeds: Number of seeds.
        episodes: Number of episodes, all seeds together.
        successes: How many of them succeeded.
        mean: Mean over the seeds of their success rates.
        deviation: Standard deviation over the seeds; None for a single one.
        low: Lower end of the 95 % Wilson interval over all episodes.
        high: Upper end.
        failures: How often the others failed in which way, most frequent first.
        difference: To the raw agent in the same episodes; None for itself, and where the two share no episode.
        chunks: Proposals that the adapter saw.
        intervention: Share of them that it edited; None if there were none, like the other means over chunks.
        distance: Mean distance of executed from proposed actions, in the adapter's normalised units.
        milliseconds: Mean time of the adapter for a chunk.
        evaluations: Mean network evaluations for a chunk.
        scores_left: Histogram of the scores of chunks that were not edited.
        scores_edited: The same of those that were.
        rank: 1 for the best method under this perturbation, 2 for the second best, else 0; also 0 while methods have
            not all played the same episodes.
    """

    seeds: int
    episodes: int
    successes: int
    mean: float
    deviation: float | None
    low: float
    high: float
    failures: dict[str, int]
    difference: PairedDifference | None
    chunks: int
    intervention: float | None
    distance: float | None
    milliseconds: float | None
    evaluations: float | None
    scores_left: dict[int, int]
    scores_edited: dict[int, int]
    rank: int = 0


@dataclass(frozen=True)
class Section:
    """What can be compared: one task, agent and split.

    Attributes:
        name: The task's name in the benchmark, or else its `--env.type`.
        shared: The conditions that its rows have in common.
        agent: Where the agent came from.
        methods: For each column of the tables, in their order, the first of its rows.
        perturbations: For each line of the tables, in their order, its perturbation with all options written out.
        results: By perturbation and column.
    """

    name: str
    shared: dict[str, Any]
    agent: str
    methods: dict[str, Row]
    perturbations: dict[str, str]
    results: dict[tuple[str, str], Result]

    @property
    def task(self) -> str:
        """The `--env.type` of the task."""
        return str(self.shared["env"]["type"])

    @property
    def raw(self) -> str | None:
        """The raw agent's column, if it was run."""
        return next((name for name, row in self.methods.items() if row["cell"]["method"] == NONE), None)

    @property
    def seeds(self) -> int:
        """The most seeds that a result has."""
        return max(result.seeds for result in self.results.values())


def task(row: Row) -> str:
    """The name that a row's task was given, or else its `--env.type`."""
    return str(row["cell"].get("task") or row["conditions"]["env"]["type"])


def column(row: Row) -> str:
    """A row's column in the tables: the label that its method was given, or else the method itself."""
    cell = row["cell"]
    return str(cell.get("label") or (AGENT if cell["method"] == NONE else cell["method"]))


def line(row: Row) -> str:
    """A row's line in the tables: the label that its perturbation was given, or else the perturbation itself."""
    cell = row["cell"]
    return str(cell.get("perturbation_label") or cell["perturbation"])


def summarise(rows: Sequence[Row]) -> list[Section]:
    """The figures of a benchmark, or of several: a section for each task, agent and split.

    Raises:
        ValueError: If there are no rows, or rows contradict each other.
    """
    if not rows:
        raise ValueError("there are no rows to report")
    sections: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        shared = [row["conditions"].get(key) for key in SHARED]
        sections[json.dumps([task(row), *shared], sort_keys=True)].append(row)
    return [_section(together) for together in sections.values()]


def _section(rows: Sequence[Row]) -> Section:
    _check_made_alike(rows)
    found: dict[tuple[str, str], Episodes] = defaultdict(dict)
    for row in _without_repetitions(rows):
        cell = row["cell"]
        for episode in (Episode(**values) for values in row["episodes"]):
            found[line(row), column(row)][cell["seed"], episode.seed] = episode
    methods: dict[str, Row] = {}
    for row in sorted(rows, key=_column_order):
        methods.setdefault(column(row), row)
    raw = next((name for name, row in methods.items() if row["cell"]["method"] == NONE), None)
    results = {
        (perturbation, name): _result(episodes, {} if name == raw else found.get((perturbation, raw or ""), {}))
        for (perturbation, name), episodes in found.items()
    }
    perturbations = {line(row): str(row["conditions"]["perturbation"]) for row in sorted(rows, key=_line_order)}
    for name in perturbations:
        played = {method: episodes.keys() for (here, method), episodes in found.items() if here == name}
        if len(set(map(frozenset, played.values()))) == 1:
            for method, rank in ranks({method: results[name, method].mean for method in played}).items():
                results[name, method] = replace(results[name, method], rank=rank)
    return Section(
        name=task(rows[0]),
        shared={key: rows[0]["conditions"].get(key) for key in SHARED},
        agent=rows[0]["checkpoints"]["agent"],
        methods=methods,
        perturbations=perturbations,
        results=results,
    )


def _check_made_alike(rows: Sequence[Row]) -> None:
    """Refuse to put what was made in different ways into one line or column."""
    lines: dict[str, Any] = {}
    columns: dict[str, Any] = {}
    both: dict[str, Any] = {}
    for row in rows:
        conditions = {key: value for key, value in row["conditions"].items() if key not in SHARED}
        perturbation, agent_flow = conditions.pop("perturbation", None), conditions.pop("agent_flow", None)
        for known, name, here in (
            (lines, line(row), perturbation),
            (columns, column(row), conditions),
            (both, f"{line(row)} / {column(row)}", agent_flow),
        ):
            if known.setdefault(name, here) != here:
                raise ValueError(f"rows of {name!r} were made in two ways, {known[name]} and {here}: report them apart")


def _without_repetitions(rows: Sequence[Row]) -> Iterable[Row]:
    """Each cell once, since two folders may both hold the raw agent's.

    Raises:
        ValueError: If they do not agree on a cell's episodes.
    """
    outcomes: dict[tuple[str, str, int], list[tuple[int, bool]]] = {}
    for row in rows:
        key = (line(row), column(row), row["cell"]["seed"])
        here = [(episode["seed"], episode["success"]) for episode in row["episodes"]]
        if key not in outcomes:
            outcomes[key] = here
            yield row
        elif outcomes[key] != here:
            cell = f"{key[0]} / {key[1]} / seed {key[2]}"
            raise ValueError(f"{cell} is there twice, with different outcomes: report only one of the folders")


def _result(episodes: Episodes, raw: Episodes) -> Result:
    by_seed = defaultdict(list)
    for (seed, _), episode in episodes.items():
        by_seed[seed].append(episode.success)
    rates = [fmean(outcomes) for outcomes in by_seed.values()]
    successes = sum(episode.success for episode in episodes.values())
    low, high = wilson(successes, len(episodes))
    failures = Counter(episode.failure for episode in episodes.values() if not episode.success)
    pairs = sorted(episodes.keys() & raw.keys())
    before, after = [raw[pair].success for pair in pairs], [episodes[pair].success for pair in pairs]
    chunks = sum(episode.chunks for episode in episodes.values())

    def over_chunks(name: str) -> float | None:
        total = sum(getattr(episode, name) * episode.chunks for episode in episodes.values())
        return total / chunks if chunks else None

    return Result(
        seeds=len(rates),
        episodes=len(episodes),
        successes=successes,
        mean=fmean(rates),
        deviation=stdev(rates) if len(rates) > 1 else None,
        low=low,
        high=high,
        failures=dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        difference=paired_difference(before, after) if pairs else None,
        chunks=chunks,
        intervention=sum(episode.edited for episode in episodes.values()) / chunks if chunks else None,
        distance=over_chunks("distance"),
        milliseconds=over_chunks("milliseconds"),
        evaluations=over_chunks("evaluations"),
        scores_left=histogram.total(episode.scores_left for episode in episodes.values()),
        scores_edited=histogram.total(episode.scores_edited for episode in episodes.values()),
    )


def ranks(rates: Mapping[str, float]) -> dict[str, int]:
    """1 for the best, 2 for the second best of at least three, 0 for all others and where all are equal."""
    ordered = sorted({round(rate, 9) for rate in rates.values()}, reverse=True)
    marked = ordered[:1] if len(rates) < 3 else ordered[:2]
    if len(ordered) == 1:
        marked = []
    return {name: marked.index(round(r, 9)) + 1 if round(r, 9) in marked else 0 for name, r in rates.items()}


def _column_order(row: Row) -> tuple[int, str]:
    """The paper's order; a method of another name stands where the paper has its editor."""
    method = row["cell"]["method"]
    editor, gated = method.partition(":")[0].removesuffix("+gate"), method.endswith("+gate")
    places = {label.lower(): place for place, label in enumerate(COLUMNS)} | {NONE: 0}
    found = [name.lower() for name in (column(row), editor + "+gate" * gated, editor) if name.lower() in places]
    return places[found[0]] if found else len(COLUMNS), column(row)


def _line_order(row: Row) -> tuple[int, str]:
    """Nothing perturbed first, then the paper's order."""
    order = (NONE, *KINDS)
    kind = row["conditions"]["perturbation"].partition(":")[0]
    return order.index(kind) if kind in order else len(order), line(row)
