"""What makes a table fair: corrected p-values, clustered episodes, and what each column is told."""

from copy import deepcopy

import pytest

from lerobot_gloves.report.statistics import paired_difference, wilson
from tests.benchmark.rows import labelled, row
from tests.report.test_markdown import TOLD, columns, report, tables


def test_p_values_are_corrected_for_the_comparisons_of_their_table() -> None:
    """Four pairs that all differ have p = 1 / 8, and one of four 1: corrected for three, 3 / 8, 3 / 8 and 1."""
    rows = [row("slow", "none", 0, [0] * 4), row("slow", "fpas", 0, [1, 0, 0, 0])]
    rows += [row("slow", name, 0, [1] * 4) for name in ("feeg", "ifae")]
    _, difference, *_ = tables(report(rows))
    found = {name: difference["slow", name].partition("p = ")[2] for name in columns(difference)}
    assert found == {"fpas": "1.000", "feeg": "0.375", "ifae": "0.375"}
    assert "Holm-corrected (comparisons in this table: 3)" in report(rows)


def test_episodes_that_begin_alike_are_clusters_and_the_captions_say_so() -> None:
    """Slalom's corridor is the seed modulo 24: of 48 episodes two each, and here with one fate."""
    raw, mended = [1, 0, 0, 0] * 12, [1, 1, 0, 0] * 12
    text = report([row("slow", "none", 0, raw), row("slow", "feeg", 0, mended)])
    success, difference, *_ = tables(text)
    low, high = wilson(12, 24)
    assert success["slow", "feeg"] == f"**50.0 [{100 * low:.1f}, {100 * high:.1f}]**"
    found = paired_difference([bool(one) for one in raw[:24]], [bool(one) for one in mended[:24]])
    assert difference["slow", "feeg"] == f"+25.0 [{100 * found.low:+.1f}, {100 * found.high:+.1f}], p = 0.031"
    assert found.p_value == pytest.approx(0.031, abs=5e-4), "6 corridors gained, none lost: 2 / 2^6"
    assert text.count("cluster-robust: the episodes share 24 initial states") == 2
    assert "sign-flip test by initial state" in text and "McNemar" not in text
    elsewhere = deepcopy([row("slow", "none", 0, raw), row("slow", "feeg", 0, mended)])
    for one in elsewhere:
        one["conditions"]["env"]["type"] = "other_peoples"
    text = report(elsewhere)
    low, high = wilson(24, 48)
    assert tables(text)[0]["slow", "feeg"] == f"**50.0 [{100 * low:.1f}, {100 * high:.1f}]**"
    assert "cluster" not in text and "exact McNemar test" in text


def test_every_column_says_what_it_is_told() -> None:
    """By the rows' own conditions; of an editor that is not known, or an IFAE without a name, nothing is claimed."""
    rows = [
        row("slow", method, 0, [0, 1, 0, 1]) for method in ("none", "feeg+gate", "copilot:limit=0.4", "mine", "ifae")
    ]
    named = labelled(row("slow", "ifae", 0, [1, 1, 1, 1]), label="IFAE")
    named["conditions"]["options"] = {"adapter_overrides": ["--agent_source={perturbation}"]}
    second = labelled(row("slow", "feeg", 0, [1, 1, 1, 1]), label="two flows")
    second["conditions"]["agent_flow"] = "d" * 64
    success, *others = tables(report([*rows, named, second]))
    assert {name: success[TOLD, name] for name in columns(success)} == {
        "agent": "nothing",
        "feeg+gate": "nothing",
        "copilot:limit=0.4": "kinds of faults",
        "mine": "–",
        "ifae": "–",
        "IFAE": "the fault's name and its data",
        "two flows": "the fault's name and its data",
    }
    assert not any(TOLD in {head for head, _ in other} for other in others), "tables of success only"
