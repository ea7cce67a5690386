"""The demo's table."""

from collections.abc import Sequence

from lerobot_gloves.demo.evaluation import PlayedRun
from lerobot_gloves.report.statistics import paired_difference, wilson
from lerobot_gloves.system.text import markdown_table

HEADER = ["method", "success, % [95 % interval]", "chunks edited", "distance", "minus raw, points [95 % interval]"]


def table(runs: Sequence[PlayedRun]) -> str:
    """A Markdown table whose columns also line up in a terminal.

    Args:
        runs: Over the same episodes, the raw agent's first.
    """
    raw = runs[0]
    return markdown_table([HEADER, *(row(played, raw) for played in runs)])


def row(played: PlayedRun, raw: PlayedRun) -> list[str]:
    """One method's cells; the raw agent is compared with nothing."""
    count, trials = sum(played.successes), len(played.successes)
    low, high = wilson(count, trials)
    cells = [played.run.label, f"{100 * count / trials:5.1f} [{100 * low:.1f}, {100 * high:.1f}]"]
    if played.intervention_rate is None or played.distance is None:
        return [*cells, "–", "–", "–"]
    found = paired_difference(raw.successes, played.successes)
    difference = f"{100 * found.mean:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"
    return [*cells, f"{100 * played.intervention_rate:.1f} %", f"{played.distance:.3f}", difference]
