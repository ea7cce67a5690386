"""The study of the gate: what it counts, against counts by hand."""

from pathlib import Path

import pytest
import torch

from lerobot_gloves.checkpoints.calibration import Calibration
from tests.report.test_markdown import tables

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import study_gate

    return study_gate


def judged(script, scores, perturbed, episode):
    names = script.written_out("+".join(script.SCORES))
    values = {name: torch.full((len(perturbed),), 0.5).double() for name in names}
    values["correction"] = torch.tensor(scores).double()
    return script.Judged(values, torch.tensor(perturbed), torch.tensor(episode), 0.5)


def test_level_power_and_area_are_those_counted_by_hand(script):
    """Calibrated by 1 to 99, a score of s has the p-value (101 - ceil(s)) / 100: at 0.05 from 96 on it is stopped."""
    names = script.written_out("+".join(script.SCORES))
    calibration = Calibration(
        {name: torch.arange(1.0, 100.0)[None] for name in names}, "me/data", "main", (0,), "hash", episode_of=(0,) * 99
    )
    # Of 40 healthy chunks in four episodes one is at 96, so alpha may be 0.05 (2.5 %), and is not 0.1 if three are
    # between: 7.5 %, or more.
    scores = [96.0, 91.0, 92.0, *range(1, 38)]
    healthy = judged(script, scores, [False] * 40, [row // 10 for row in range(40)])
    fault = judged(script, [99.0, 50.0, 99.0, 0.5], [True, True, True, False], [0, 0, 1, 1])
    (table,) = tables(script.table(healthy, {"shift": fault}, calibration, {}))
    assert table["correction", "alpha"] == "0.05"
    assert table["correction", "healthy chunks"] == "2.5 %" and table["correction", "healthy episodes"] == "25 %"
    # Of the three that were changed two are stopped; two lie above all 40 healthy ones, one above the 37 low ones.
    assert table["correction", "shift (50 %)"] == f"{(40 + 40 + 37) / 120:.2f} (67 %)"
    # With a score that says nothing beside it, each has half of alpha: nothing below 0.02 is stopped at 0.02 / 2.
    joined = "reverse:steps=1+correction"
    (table,) = tables(script.table(healthy, {"shift": fault}, calibration, {joined: 0.04, "correction": 0.01}))
    assert table[joined, "healthy chunks"] == "0.0 %" and table[joined, "shift (50 %)"].endswith("(67 %)")
    assert table["correction", "alpha"] == "0.01" and table["correction", "healthy chunks"] == "0.0 %"
