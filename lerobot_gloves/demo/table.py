"""The demo's table."""

from collections.abc import Sequence

from lerobot_gloves.demo.evaluation import Result
from lerobot_gloves.report.statistics import paired_difference, wilson

HEADER = ["method", "success, % [95 % interval]", "chunks edited", "distance", "minus raw, points [95 % interval]"]


def table(results: Sequence[Result]) -> str:
    """A Markdown table whose columns also line up in a terminal.

    Args:
        results: Runs over the same episodes, the raw agent's first.
    """
    raw = results[0]
    lines = [HEADER, *(row(result, raw) for result in results)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
    lines.insert(1, ["-" * width for width in widths])
    padded = [[text.ljust(width) for text, width in zip(line, widths, strict=True)] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in padded)


def row(result: Result, raw: Result) -> list[str]:
    """One method's cells; the raw agent is compared with nothing."""
    count, trials = sum(result.successes), len(result.successes)
    low, high = wilson(count, trials)
    cells = [result.method.label, f"{100 * count / trials:5.1f} [{100 * low:.1f}, {100 * high:.1f}]"]
    if result.intervention_rate is None or result.distance is None:
        return [*cells, "–", "–", "–"]
    found = paired_difference(raw.successes, result.successes)
    difference = f"{100 * found.mean:+.1f} [{100 * found.low:+.1f}, {100 * found.high:+.1f}]"
    return [*cells, f"{100 * result.intervention_rate:.1f} %", f"{result.distance:.3f}", difference]
