"""Rows to CSV: a line a perturbation and method, rates as fractions, empty where there is nothing to say."""

import csv
import io
from collections.abc import Sequence
from typing import Any

from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.report.paper import SOURCE
from lerobot_gloves.report.summary import Result, Section, summarise
from lerobot_gloves.report.tables import paper_lines
from lerobot_gloves.report.told import told
from lerobot_gloves.specification import name_of

KEYS = ("task", "split", "agent", "perturbation", "strength", "method", "specification", "adapter", "told", "source")
FIGURES = (
    *(
        "seeds",
        "episodes",
        "initial_states",
        "successes",
        "success_mean",
        "success_std",
        "success_low",
        "success_high",
        "rank",
    ),
    *("pairs", "difference", "difference_low", "difference_high", "p", "p_holm"),
    *("chunks", "intervention_rate", "distance", "milliseconds", "evaluations"),
)
"""`success_low` and `_high` are the Wilson interval, `difference` is to the raw agent in the same episodes; intervals
and `p` are robust to initial states that episodes share, `p_holm` is corrected for all differences of a section."""


def report_csv(rows: Sequence[Row], *, paper: bool = False) -> str:
    """The figures of a benchmark as CSV, for other programs.

    Args:
        rows: What `gloves bench` left.
        paper: Whether the paper's own figures follow; their `source` is its table instead of `measured`.

    Raises:
        ValueError: If there are no rows, or they contradict each other.
    """
    sections = summarise(rows)
    kinds = sorted({kind for section in sections for result in section.results.values() for kind in result.failures})
    file = io.StringIO()
    writer = csv.DictWriter(file, [*KEYS, *FIGURES, *(f"failed_{kind}" for kind in kinds)], lineterminator="\n")
    writer.writeheader()
    for section in sections:
        for perturbation in section.perturbations:
            for method in section.methods:
                if result := section.results.get((perturbation, method)):
                    failures = {f"failed_{kind}": result.failures.get(kind, 0) for kind in kinds}
                    figures = _figures(result, section.corrected.get((perturbation, method)))
                    writer.writerow(_keys(section, perturbation, method) | figures | failures)
    for task, lines in paper_lines(sections).items() if paper else ():
        for perturbation, line in lines.items():
            for method, figure in line.items():
                named = {
                    "task": task,
                    "perturbation": name_of(perturbation),
                    "strength": perturbation,
                    "method": method,
                    "source": SOURCE,
                }
                shares = {"success_mean": _rounded(figure.mean), "success_std": _rounded(figure.deviation)}
                writer.writerow(named | shares)
    return file.getvalue()


def _keys(section: Section, perturbation: str, method: str) -> dict[str, Any]:
    row = section.methods[method]
    known = told(row)
    return {
        "task": section.name,
        "split": section.shared["split"],
        "agent": section.agent,
        "perturbation": perturbation,
        "strength": section.perturbations[perturbation],
        "method": method,
        "specification": row.specification,
        "adapter": row.checkpoints.get("adapter") if "adapter" in row.conditions else None,
        "told": known and known.replace("\n", " "),
        "source": "measured",
    }


def _figures(result: Result, corrected: float | None) -> dict[str, Any]:
    found = result.difference
    compared = (None,) * 5 if found is None else (found.pairs, found.mean, found.low, found.high, found.p_value)
    values = (
        *(result.seeds, result.episodes, result.states, result.successes),
        *(result.mean, result.deviation, result.low, result.high, result.rank or None),
        *compared,
        corrected,
        *(result.chunks, result.intervention, result.distance, result.milliseconds, result.evaluations),
    )
    return dict(zip(FIGURES, (_rounded(value) for value in values), strict=True))


def _rounded(value: float | None) -> float | None:
    return float(f"{value:.6g}") if isinstance(value, float) else value
