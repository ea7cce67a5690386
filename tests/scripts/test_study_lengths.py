"""The study of lengths: shares against counts by hand."""

from pathlib import Path

import pytest
import torch

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import study_lengths

    return study_lengths


def test_the_shares_are_those_counted_by_hand(script):
    """Of 99 chunks five ranks of a hundred are turned away at 0.05: those above the fifth largest, four."""
    ranks = torch.arange(1.0, 100.0)
    table = torch.stack([ranks, 3 * ranks, 3 * ranks])  # lengths 1, 2 and 3; between 1 and 3 would lie twice the rank
    interpolated, larger, leading = script.turned_away(table, 1, 2, 3, alpha=0.05)
    # 3 r > 2 * 95 from r = 64 on: 36 chunks; 3 r > 3 * 95 and r > 95: four.
    assert [round(99 * share) for share in (interpolated, larger, leading)] == [36, 4, 4]


def test_scoring_is_timed(script):
    assert script.seconds(4, 2) > 0
