"""What scores tell apart and cost: every score stands in one table, with the evaluations that its settings say."""

import sys
from pathlib import Path

import pytest
import torch

from tests.report.test_markdown import tables

SCRIPTS = Path(__file__).parents[2] / "scripts"
EVALUATIONS = {
    "reverse:steps=2": "2",
    "residual:times=1": "2",
    "likelihood:steps=3": "3",
    "selfnormalised:samples=2": "28",
}


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import benchmark_scores

    return benchmark_scores


def test_all_scores_stand_side_by_side(script, monkeypatch, capsys):
    options = ["--demonstrations=1", "--batch=2", "--repeats=1"]
    monkeypatch.setattr(sys, "argv", ["benchmark_scores.py", *EVALUATIONS, *options])
    script.main()
    (table,) = tables(capsys.readouterr().out)
    assert {name: table[name, "evaluations"] for name in EVALUATIONS} == EVALUATIONS
    assert {name for name, _ in table} == EVALUATIONS.keys()
    for name in EVALUATIONS:
        assert float(table[name, "milliseconds a chunk"]) > 0 and float(table[name, "times the first"]) > 0
        area, seen = table[name, "noised"].removesuffix(" %)").split(" (")
        assert 0.5 < float(area) <= 1 and 0 <= int(seen) <= 100


def test_area_and_share_by_counting(script):
    clean, worse = torch.tensor([1.0, 2.0, 3.0, 4.0]), torch.tensor([0.0, 2.0, 9.0])
    pairs = [1.0 if bad > good else 0.5 if bad == good else 0.0 for bad in (0, 2, 9) for good in (1, 2, 3, 4)]
    assert script.auroc(clean, worse) == pytest.approx(sum(pairs) / 12)
    assert script.power(clean, worse) == pytest.approx(1 / 3)
