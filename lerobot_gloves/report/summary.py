"""Rows to figures: what the report says of each perturbation with each method."""

import json
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, stdev
from typing import Any, NamedTuple

from lerobot_gloves.benchmark.alike import Conditions, differences, parts, shared
from lerobot_gloves.benchmark.cell import gated
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.evaluation import histogram
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.report.initial_states import initial_state
from lerobot_gloves.report.paper import COLUMNS, KINDS
from lerobot_gloves.report.statistics import PairedDifference, holm, paired_difference, success_interval
from lerobot_gloves.specification import NONE, name_of


class Played(NamedTuple):
    """Which episode: the policies' seed, the environment's, and what the task begins with there."""

    seed: int
    environment: int
    state: Hashable


type Outcomes = dict[Played, bool]
"""Whether each episode of one perturbation and method succeeded."""
type _Episodes = dict[Played, Episode]


@dataclass(frozen=True)
class Result:
    """One perturbation with one method. Rates lie in [0, 1].

    Attributes:
        seeds: Number of seeds.
        episodes: Number of episodes, all seeds together.
        successes: How many of them succeeded.
        mean: Mean over the seeds of their success rates.
        deviation: Standard deviation over the seeds; None for a single one.
        low: Lower end of the 95 % Wilson interval over all episodes, see `success_interval`.
        high: Upper end.
        outcomes: All episodes.
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
    outcomes: Outcomes
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

    @property
    def states(self) -> int:
        """In how many states its episodes begin."""
        return len({played.state for played in self.outcomes})


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
        return next((name for name, row in self.methods.items() if row.cell.raw), None)

    @property
    def seeds(self) -> int:
        """The most seeds that a result has."""
        return max(result.seeds for result in self.results.values())

    @property
    def states(self) -> int | None:
        """The most initial states that a result's episodes share; None where each begins in its own, or all alike."""
        shared = [result.states for result in self.results.values() if 1 < result.states < result.episodes]
        return max(shared, default=None)

    @property
    def corrected(self) -> dict[tuple[str, str], float]:
        """The p-values of the differences to the raw agent, Holm-corrected for the number of all of them."""
        found = {key: result.difference.p_value for key, result in self.results.items() if result.difference}
        return dict(zip(found, holm(list(found.values())), strict=True))


def summarise(rows: Sequence[Row]) -> list[Section]:
    """The figures of a benchmark, or of several: a section for each task, agent and split.

    Raises:
        ValueError: If there are no rows, or rows contradict each other.
    """
    if not rows:
        raise ValueError("there are no rows to report")
    sections: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        sections[json.dumps([row.task, shared(row.conditions)], sort_keys=True)].append(row)
    return [_section(together) for together in sections.values()]


def _section(rows: Sequence[Row]) -> Section:
    _check_made_alike(rows)
    found: dict[tuple[str, str], _Episodes] = defaultdict(dict)
    state = initial_state(shared(rows[0].conditions)["env"])
    for row in _without_repetitions(rows):
        for episode in row.episodes:
            played = Played(row.cell.seed, episode.seed, state(episode.seed))
            found[row.cell.line, row.cell.column][played] = episode
    methods: dict[str, Row] = {}
    for row in sorted(rows, key=_column_order):
        methods.setdefault(row.cell.column, row)
    raw = next((name for name, row in methods.items() if row.cell.raw), None)
    results = {
        (perturbation, name): _result(episodes, None if name == raw else found.get((perturbation, raw or "")))
        for (perturbation, name), episodes in found.items()
    }
    perturbations = {row.cell.line: str(row.conditions["perturbation"]) for row in sorted(rows, key=_line_order)}
    for name in perturbations:
        beside = {method: episodes.keys() for (here, method), episodes in found.items() if here == name}
        if len(set(map(frozenset, beside.values()))) == 1:
            for method, rank in ranks({method: results[name, method].mean for method in beside}).items():
                results[name, method] = replace(results[name, method], rank=rank)
    return Section(
        name=rows[0].task,
        shared=shared(rows[0].conditions),
        agent=str(rows[0].checkpoints["agent"]),
        methods=methods,
        perturbations=perturbations,
        results=results,
    )


def _check_made_alike(rows: Sequence[Row]) -> None:
    """Refuse to put what was made in different ways into one line or column."""
    known: dict[tuple[str, ...], Conditions] = {}
    for row in rows:
        for part, here in parts(row.cell, row.conditions):
            first = known.setdefault(part, here)
            if first != here:
                ways = " and ".join(", ".join(differences(*pair)) for pair in ((here, first), (first, here)))
                raise ValueError(f"rows of {' / '.join(part[2:])!r} were made in two ways, {ways}: report them apart")


def _without_repetitions(rows: Sequence[Row]) -> Iterable[Row]:
    """Each cell once, since two folders may both hold the raw agent's.

    Raises:
        ValueError: If they do not agree on a cell's episodes.
    """
    outcomes: dict[tuple[str, str, int], list[tuple[int, bool]]] = {}
    for row in rows:
        key = (row.cell.line, row.cell.column, row.cell.seed)
        here = [(episode.seed, episode.success) for episode in row.episodes]
        if key not in outcomes:
            outcomes[key] = here
            yield row
        elif outcomes[key] != here:
            cell = f"{key[0]} / {key[1]} / seed {key[2]}"
            raise ValueError(f"{cell} is there twice, with different outcomes: report only one of the folders")


def compare(before: Outcomes, after: Outcomes) -> PairedDifference | None:
    """A method's outcomes minus another's in the episodes that both have; None if there are none."""
    pairs = sorted(before.keys() & after.keys(), key=lambda played: played[:2])
    if not pairs:
        return None
    clusters = [played.state for played in pairs]
    return paired_difference([before[one] for one in pairs], [after[one] for one in pairs], clusters)


def _outcomes(episodes: _Episodes) -> Outcomes:
    return {played: episode.success for played, episode in episodes.items()}


def _result(episodes: _Episodes, raw: _Episodes | None) -> Result:
    outcomes = _outcomes(episodes)
    by_seed = defaultdict(list)
    for played, success in outcomes.items():
        by_seed[played.seed].append(success)
    rates = [fmean(successes) for successes in by_seed.values()]
    low, high = success_interval(list(outcomes.values()), [played.state for played in outcomes])
    failures = Counter(episode.failure for episode in episodes.values() if not episode.success)
    chunks = sum(episode.chunks for episode in episodes.values())

    def over_chunks(name: str) -> float | None:
        total = sum(getattr(episode, name) * episode.chunks for episode in episodes.values())
        return total / chunks if chunks else None

    return Result(
        seeds=len(rates),
        episodes=len(episodes),
        successes=sum(outcomes.values()),
        mean=fmean(rates),
        deviation=stdev(rates) if len(rates) > 1 else None,
        low=low,
        high=high,
        outcomes=outcomes,
        failures=dict(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        difference=None if raw is None else compare(_outcomes(raw), outcomes),
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
    cell, editor = row.cell, name_of(row.cell.editor)
    places = {label.lower(): place for place, label in enumerate(COLUMNS)} | {NONE: 0}
    found = [name.lower() for name in (cell.column, gated(editor, cell.gate), editor) if name.lower() in places]
    return places[found[0]] if found else len(COLUMNS), cell.column


def _line_order(row: Row) -> tuple[int, str]:
    """Nothing perturbed first, then the paper's order."""
    order = (NONE, *KINDS)
    kind = name_of(row.conditions["perturbation"])
    return order.index(kind) if kind in order else len(order), row.cell.line
