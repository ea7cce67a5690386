"""All cells together: means, their differences and intervals, and in how many cells a method is better."""

from typing import Any

import numpy as np
import pytest

from lerobot_gloves.report.overall import Overall, overall_table
from lerobot_gloves.report.paper import COLUMNS, KINDS
from lerobot_gloves.report.summary import summarise
from tests.benchmark.rows import labelled, loaded, row

EPISODES = 24


def played(task: str, rates: dict[str, float], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Rows of two seeds of 24 episodes of every column and kind; corridors of Slalom differ in difficulty."""
    rows = []
    difficulty = rng.normal(0, 0.3, 2 * EPISODES)  # of one environment seed, whatever is done to the agent
    for kind in ("none", *KINDS):
        for column in COLUMNS:
            editor = "none" if column == COLUMNS[0] else column.lower()
            for seed in range(2):
                hard = difficulty[seed * EPISODES : (seed + 1) * EPISODES]
                outcomes = rng.random(EPISODES) < rates.get(column, 0.5) + hard
                one = labelled(row(kind, editor, seed, outcomes.astype(int).tolist()), label=column, task=task)
                one["conditions"]["env"] = {"type": f"gloves_{task}"}
                rows.append(one)
    return rows


@pytest.fixture(scope="module")
def overall() -> Overall:
    rng = np.random.default_rng(0)
    tasks = [played(task, {"agent": 0.2, "CSA": 0.8, "FEEG": 0.7}, rng) for task in ("slalom", "charger")]
    return Overall([summarise(loaded(rows))[0] for rows in tasks])


def difference(overall: Overall, section: int, method: str, other: str) -> np.ndarray:
    """Of every kind (4) and episode (48)."""
    results = overall.sections[section].results
    return np.array(
        [
            [int(after) - int(before) for after, before in zip(*outcomes, strict=True)]
            for kind in KINDS
            for outcomes in [[results[kind, name].outcomes.values() for name in (method, other)]]
        ]
    )


@pytest.mark.parametrize(("method", "other"), [("CSA", "agent"), ("FEEG", "agent"), ("FEEG", "CSA")])
def test_the_mean_differences_interval_is_that_of_independent_beginnings(
    overall: Overall, method: str, other: str
) -> None:
    """Textbook's: the variance of a mean of independent ones, 24 corridors and 48 charger scenes, of two tasks."""
    slalom, charger = (difference(overall, section, method, other) for section in range(2))
    corridors = [[(10000 + 100 * seed + i) % 24 for i in range(EPISODES)] for seed in range(2)]
    by_corridor = [slalom.mean(axis=0)[np.ravel(corridors) == corridor].mean() for corridor in range(24)]
    variance = np.var(by_corridor, ddof=1) / 24 + np.var(charger.mean(axis=0), ddof=1) / 48
    mean, half = 50 * (slalom.mean() + charger.mean()), 50 * 1.959964 * np.sqrt(variance)
    found = overall.against(method, other)
    assert (found.mean, found.low, found.high) == pytest.approx((mean, mean - half, mean + half), rel=1e-6)
    assert found.mean == pytest.approx(overall.mean(method) - overall.mean(other))


def test_cells_are_better_or_worse_where_the_corrected_p_value_says_so(overall: Overall) -> None:
    assert sum(map(len, overall.comparisons.values())) == 8 * (7 + 6), "with the agent seven, with CSA six more"
    corrected = [p for several in overall.comparisons.values() for _, p in several]
    plain = [found.p_value for several in overall.comparisons.values() for found, _ in several]
    assert min(corrected) == pytest.approx(8 * 13 * min(plain)) and all(np.array(corrected) >= plain)
    for method, other in (("CSA", "agent"), ("DDPM", "CSA"), ("FEEG", "CSA")):
        found, cells = overall.against(method, other), overall.comparisons[method, other]
        assert found.better == sum(p < 0.05 and one.mean > 0 for one, p in cells)
        assert found.worse == sum(p < 0.05 and one.mean < 0 for one, p in cells)
    assert overall.against("CSA", "agent").better >= 6 and overall.against("CSA", "agent").worse == 0
    assert overall.against("DDPM", "CSA").worse >= 1 and overall.against("DDPM", "CSA").better == 0


def test_the_table_begins_with_what_is_told_and_with_the_means(overall: Overall) -> None:
    table = overall_table(overall, {"CSA": "6 to 12"})
    lines = {
        line[0].text: dict(zip(table.header[1:], (entry.in_one_line for entry in line[1:]), strict=True))
        for line in table.lines
    }
    assert list(lines)[:7] == [
        *("what it is told", "settings in each task's search", "mean of 8", "mean minus agent's"),
        *("cells better, worse than agent", "mean minus CSA's", "cells better, worse than CSA"),
    ]
    assert lines["settings in each task's search"] | {"CSA": ""} == dict.fromkeys(COLUMNS, "–") | {"CSA": ""}
    found = overall.against("FEEG", "CSA")
    assert lines["mean minus CSA's"]["FEEG"] == f"{found.mean:+.1f} [{found.low:+.1f}, {found.high:+.1f}]"
    assert lines["cells better, worse than CSA"]["FEEG"] == f"{found.better}, {found.worse}"
    assert (
        {lines["mean minus CSA's"][name] for name in ("agent", "CSA")}
        == {lines["mean minus agent's"]["agent"]}
        == {"–"}
    )
    assert "comparisons in this table: 104" in table.caption
