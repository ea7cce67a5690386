"""Every figure of the tables, against hand-counted episodes."""

import re
from statistics import stdev
from typing import Any

import pytest

from lerobot_gloves.benchmark.report import report
from lerobot_gloves.benchmark.statistics import paired_difference, wilson

SHARED = {
    "env": {"type": "gloves_slalom", "task": "Slalom-v0", "obs_type": "state", "mode": None},
    "agent": "a" * 64,
    "split": "test",
    "episodes": 4,
    "batch_size": 4,
}


def row(perturbation: str, method: str, seed: int, successes: list[int], **facts: Any) -> dict[str, Any]:
    own = {} if method == "none" else {"score": "reverse:steps=1", "alpha": 0.05, "adapter": "b" * 64}
    episodes = [
        {"seed": 10000 + 100 * seed + i, "success": bool(s), "failure": "" if s else "collision", "steps": 50, **facts}
        for i, s in enumerate(successes)
    ]
    return {
        "cell": {"perturbation": perturbation, "method": method, "seed": seed},
        "conditions": {**SHARED, "perturbation": perturbation, "method": method, **own},
        "checkpoints": {"agent": "my/agent", "adapter": "my/adapter"},
        "episodes": episodes,
    }


ROWS = [
    row("slow", "feeg+gate", 1, [1, 1, 1, 0], chunks=10, edited=2, distance=0.1),
    row("slow", "feeg+gate", 0, [1, 1, 0, 0], chunks=5, edited=4, distance=0.4),
    row("slow", "none", 0, [0, 1, 0, 0]),
    row("slow", "none", 1, [0, 0, 1, 0]),
    row("none", "none", 0, [1, 1, 1, 1]),
]


def tables(text: str) -> list[dict[tuple[str, str], str]]:
    """The tables of a report, by perturbation and method."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", text, flags=re.M):
        header, _, *lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in block.splitlines()]
        found.append({(line[0], method): cell for line in lines for method, cell in zip(header, line, strict=True)})
    return found


def test_success() -> None:
    success, _, _ = tables(report(ROWS))
    low, high = wilson(5, 8)
    assert success["slow", "feeg+gate"] == f"62.5 ± {stdev([50, 75]):.1f} [{100 * low:.1f}, {100 * high:.1f}]"
    low, high = wilson(2, 8)
    assert success["slow", "none"] == f"25.0 ± 0.0 [{100 * low:.1f}, {100 * high:.1f}]"
    low, high = wilson(4, 4)
    assert success["none", "none"] == f"100.0 [{100 * low:.1f}, 100.0]", "one seed has no deviation"
    assert success["none", "feeg+gate"] == "–", "not run"


def test_difference_to_the_raw_agent_is_paired() -> None:
    _, difference, _ = tables(report(ROWS))
    raw, adapted = [0, 1, 0, 0, 0, 0, 1, 0], [1, 1, 0, 0, 1, 1, 1, 0]
    expected = paired_difference([bool(s) for s in raw], [bool(s) for s in adapted])
    assert expected.mean == pytest.approx(3 / 8)
    assert (
        difference["slow", "feeg+gate"] == f"+37.5 [{100 * expected.low:+.1f}, {100 * expected.high:+.1f}], p = 0.250"
    )
    assert difference["slow", "none"] == ""


def test_pairs_are_the_episodes_that_both_have() -> None:
    """Without the raw agent's seed 0, only seed 1 is compared; without any, nothing is."""
    _, difference, _ = tables(report([r for r in ROWS if r is not ROWS[2]]))
    assert difference["slow", "feeg+gate"].startswith("+50.0 ")
    _, difference, _ = tables(report(ROWS[:2]))
    assert difference["slow", "feeg+gate"] == "–"


def test_edits_are_weighed_by_chunks() -> None:
    """4 episodes of 5 chunks and 4 of 10: 16 + 8 of 60 edited, mean distance (20 x 0.4 + 40 x 0.1) / 60."""
    _, _, edits = tables(report(ROWS))
    assert edits["slow", "feeg+gate"] == "40.0; 0.200"
    assert edits["slow", "none"] == ""


def test_headline_says_what_was_run() -> None:
    text = report(ROWS)
    assert "## gloves_slalom, test split" in text
    assert "task=Slalom-v0, obs_type=state; 4 episodes for each of the seeds 0, 1, 4 side by side." in text
    assert "Agent my/agent (aaaaaaaaaaaa)." in text
    assert "- feeg+gate: feeg+gate, score reverse:steps=1, alpha 0.05, adapter my/adapter (bbbbbbbbbbbb)" in text


def test_no_rows() -> None:
    with pytest.raises(ValueError, match="no rows"):
        report([])
