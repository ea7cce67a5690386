import csv
import io

import pytest

from lerobot_gloves.report.csv_file import report_csv
from lerobot_gloves.report.statistics import newcombe, wilson
from tests.benchmark.rows import ROWS, loaded, row


def read(text: str) -> dict[tuple[str, str, str], dict[str, str]]:
    return {(line["strength"], line["method"], line["source"]): line for line in csv.DictReader(io.StringIO(text))}


def test_every_figure_of_a_line() -> None:
    """What the tables' tests count by hand, as fractions."""
    lines = read(report_csv(loaded(ROWS)))
    assert set(lines) == {
        ("slow", "feeg+gate", "measured"),
        ("slow", "agent", "measured"),
        ("none", "agent", "measured"),
    }
    line = lines["slow", "feeg+gate", "measured"]
    found = {key: float(line[key]) for key in line if key not in KEYS}
    low, high = wilson(5, 8)
    difference_low, difference_high = newcombe(2, 3, 0, 3)
    expected = {
        "seeds": 2,
        "episodes": 8,
        "initial_states": 8,
        "successes": 5,
        "success_mean": 0.625,
        "success_std": 0.1767767,
        "success_low": low,
        "success_high": high,
        "rank": 1,
        "pairs": 8,
        "difference": 0.375,
        "difference_low": difference_low,
        "difference_high": difference_high,
        "p": 0.25,
        "p_holm": 0.25,
        "chunks": 60,
        "intervention_rate": 0.4,
        "distance": 0.2,
        "milliseconds": 4.0,
        "evaluations": 7.0,
        "failed_collision": 3,
    }
    assert found == pytest.approx(expected, rel=1e-5)
    assert [line[key] for key in ("task", "split", "agent", "adapter", "specification", "told")] == [
        "gloves_slalom",
        "test",
        "my/agent",
        "my/adapter",
        "feeg+gate",
        "nothing",
    ]


KEYS = ("task", "split", "agent", "perturbation", "strength", "method", "specification", "adapter", "told", "source")


def test_p_is_of_one_comparison_and_p_holm_of_all() -> None:
    rows = [row("slow", "none", 0, [0] * 4), *(row("slow", name, 0, [1] * 4) for name in ("feeg", "fpas", "mine"))]
    lines = read(report_csv(loaded(rows)))
    assert [float(lines["slow", name, "measured"][key]) for name in ("feeg", "mine") for key in ("p", "p_holm")] == [
        *(0.125, 0.375),
        *(0.125, 0.375),
    ]
    assert lines["slow", "mine", "measured"]["told"] == ""


def test_what_there_is_not_is_empty() -> None:
    line = read(report_csv(loaded(ROWS)))["none", "agent", "measured"]
    empty = {key for key, value in line.items() if value == ""}
    assert empty == {
        *("success_std", "rank", "adapter", "pairs", "difference", "difference_low", "difference_high", "p", "p_holm"),
        *("intervention_rate", "distance", "milliseconds", "evaluations"),
    }
    assert line["failed_collision"] == "0"


def test_the_papers_figures_name_their_table() -> None:
    lines = read(report_csv(loaded(ROWS), paper=True))
    assert len(lines) == 3 + 8
    line = lines["slow:alpha=0.5,p=0.5", "IFAE", "tab:flowalign_best_triplet_comparison"]
    assert (line["success_mean"], line["success_std"], line["episodes"]) == ("0.746", "0.046", "")


def test_a_compound_without_a_label() -> None:
    compound = row("noised:sigma=0.01+laggy:p=0.2", "none", 0, [0, 0, 1, 0])
    (line,) = csv.DictReader(io.StringIO(report_csv(loaded([compound]), paper=True)))
    assert line["perturbation"] == line["strength"] == "noised:sigma=0.01+laggy:p=0.2"
    assert float(line["success_mean"]) == 0.25
