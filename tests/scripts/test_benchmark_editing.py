"""The speed of all methods: each makes the evaluations that its settings say, whatever the machine makes of them."""

import runpy
import sys
from pathlib import Path

from tests.report.test_markdown import tables

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_editing.py"
EVALUATIONS = {
    "FEEG (10 steps), its forward passes alone": "10",
    "FEEG (10 steps) with its backward passes": "10 + 10 backward",
    "IFAE (10 steps)": "20",  # the agent's flow and the expert's
    "IFAE (20 steps)": "40",
    "FPAS (5 iterations of 16)": "80",
    "DDPM (gamma 0.3)": "14",  # int(49 x 0.3) of 50 steps
    "CSA": "1",
    "copilot, unlimited": "1",
    "copilot": "2",
    "one-step gate": "1",
    "five-step gate": "5",
}


def test_all_methods_stand_side_by_side(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmark_editing.py", "--batch=3", "--repeats=1"])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.startswith("batch 3, one thread, torch ")
    assert "FEEG (10 steps) / its forward and backward passes: " in printed and "one-step gate / one forward" in printed
    (table,) = tables(printed)
    assert {name: table[name, "evaluations a chunk"] for name in EVALUATIONS} == EVALUATIONS
    assert {name for name, _ in table} == EVALUATIONS.keys()
    assert all(float(table[name, "milliseconds a chunk"]) > 0 for name in EVALUATIONS)
