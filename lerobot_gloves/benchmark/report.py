"""Rows to Markdown: success, difference to the raw agent, and how much was edited."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from statistics import fmean, stdev

from lerobot_gloves.benchmark.cell import NONE, Cell
from lerobot_gloves.benchmark.markdown import markdown_table
from lerobot_gloves.benchmark.rollout import Episode
from lerobot_gloves.benchmark.rows import Row
from lerobot_gloves.benchmark.statistics import paired_difference, wilson

type Episodes = dict[tuple[int, int], Episode]
"""Episodes of one perturbation and method, by the policies' seed and the environment's."""
type Results = dict[tuple[str, str], Episodes]
"""Episodes by perturbation and method."""


def report(rows: Sequence[Row]) -> str:
    """The tables of a benchmark, one row a perturbation and one column a method.

    Raises:
        ValueError: If there are no rows.
    """
    if not rows:
        raise ValueError("there are no rows to report")
    results: Results = defaultdict(dict)
    for row in rows:
        cell = Cell(**row["cell"])
        for episode in (Episode(**values) for values in row["episodes"]):
            results[cell.perturbation, cell.method][cell.seed, episode.seed] = episode
    parts = [
        headline(rows),
        "Success in %: mean ± standard deviation over seeds [95 % Wilson interval over all episodes].",
        table(results, success),
        "Success minus the raw agent's in the same episodes, in points [95 % interval], p of the exact McNemar test.",
        table(results, lambda here, raw: "" if here is raw else difference(here, raw)),
        "Chunks edited in %; mean distance of executed from proposed actions, in the adapter's normalised units.",
        table(results, lambda here, raw: edits(here)),
    ]
    return "\n\n".join(parts) + "\n"


def headline(rows: Sequence[Row]) -> str:
    """What the rows have in common."""
    shared, methods = rows[0]["conditions"], sorted({row["cell"]["method"] for row in rows} - {NONE})
    seeds = sorted({row["cell"]["seed"] for row in rows})
    env = ", ".join(f"{key}={value}" for key, value in shared["env"].items() if key != "type" and value is not None)
    lines = [
        f"## {shared['env']['type']}, {shared['split']} split",
        f"{env}; {shared['episodes']} episodes for each of the seeds {', '.join(map(str, seeds))}, "
        f"{shared['batch_size']} side by side. Agent {rows[0]['checkpoints']['agent']} ({shared['agent'][:12]}).",
    ]
    for method in methods:
        row = next(row for row in rows if row["cell"]["method"] == method)
        own = row["conditions"]
        lines.append(
            f"- {method}: {own['method']}, score {own['score']}, alpha {own['alpha']}, "
            f"adapter {row['checkpoints']['adapter']} ({own['adapter'][:12]})"
        )
    return "\n\n".join(lines[:2]) + ("\n\n" + "\n".join(lines[2:]) if methods else "")


def success(episodes: Episodes, raw: Episodes) -> str:
    """Mean and deviation over seeds, interval over episodes."""
    by_seed = defaultdict(list)
    for (seed, _), episode in episodes.items():
        by_seed[seed].append(episode.success)
    rates = [100 * fmean(outcomes) for outcomes in by_seed.values()]
    deviation = f" ± {stdev(rates):.1f}" if len(rates) > 1 else ""
    low, high = wilson(sum(episode.success for episode in episodes.values()), len(episodes))
    return f"{fmean(rates):.1f}{deviation} [{100 * low:.1f}, {100 * high:.1f}]"


def difference(episodes: Episodes, raw: Episodes) -> str:
    """The paired difference to the raw agent, over the episodes that both have."""
    pairs = sorted(episodes.keys() & raw.keys())
    if not pairs:
        return "–"
    found = paired_difference([raw[pair].success for pair in pairs], [episodes[pair].success for pair in pairs])
    p = f"p = {found.p_value:.3f}" if found.p_value >= 0.001 else "p < 0.001"
    return f"{100 * found.mean:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}], {p}"


def edits(episodes: Episodes) -> str:
    """Intervention rate and mean distance over all chunks."""
    chunks = sum(episode.chunks for episode in episodes.values())
    if not chunks:
        return ""
    edited = sum(episode.edited for episode in episodes.values())
    distance = sum(episode.distance * episode.chunks for episode in episodes.values()) / chunks
    return f"{100 * edited / chunks:.1f}; {distance:.3f}"


def table(results: Results, entry: Callable[[Episodes, Episodes], str]) -> str:
    """A Markdown table, one row a perturbation and one column a method.

    Args:
        results: What to tabulate.
        entry: From the episodes of a perturbation and method, and the raw agent's under that perturbation, to text.
    """

    def none_first(name: str) -> tuple[bool, str]:
        return name != NONE, name

    perturbations = sorted({perturbation for perturbation, _ in results}, key=none_first)
    methods = sorted({method for _, method in results}, key=none_first)
    lines = [["perturbation", *methods]]
    for perturbation in perturbations:
        raw: Episodes = results.get((perturbation, NONE), {})
        cells = [results.get((perturbation, method)) for method in methods]
        lines.append([perturbation, *("–" if episodes is None else entry(episodes, raw) for episodes in cells)])
    return markdown_table(lines)
