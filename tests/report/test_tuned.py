"""A second choice beside the search's: shares of a gain counted by hand."""

from types import SimpleNamespace

import pytest

from lerobot_gloves.report.summary import Played
from lerobot_gloves.report.tuned import Pair, share, tuned_table


def section(who="a", **successes):
    """One task; by method, successes of 10 episodes under none and noised."""
    results = {}
    for method, counts in successes.items():
        for kind, count in zip(("none", "noised"), counts, strict=True):
            outcomes = {Played(0, number, number): number < count for number in range(10)}
            results[kind, method] = SimpleNamespace(mean=count / 10, outcomes=outcomes)
    return SimpleNamespace(
        name="slalom",
        shared={"agent": who},
        methods=dict.fromkeys(successes),
        perturbations={"none": "none", "noised": "noised:sigma=1"},
        results=results,
    )


SEARCHED = {"agent": (10, 2), "FEEG+gate": (10, 8)}


def test_the_share_is_of_what_the_search_gained():
    pair = Pair(section(**SEARCHED), section(tuned=(9, 5)))
    assert pair.kinds == ["noised"] and pair.success("noised") == pytest.approx((20, 80, 50))
    assert share([pair]) == pytest.approx(50)
    better = Pair(section(**SEARCHED), section(tuned=(10, 8)))
    assert share([pair, better]) == pytest.approx(75)
    table = tuned_table([pair, better])
    of = table.header.index("noised")
    lines = [[entry.text for entry in line] for line in table.lines]
    assert [line[0] for line in lines] == ["slalom", "slalom", "all 2 cells"]
    assert [line[of] for line in lines] == ["20.0 / 80.0 / 50.0", "20.0 / 80.0 / 80.0", ""]
    assert [line[-2] for line in lines] == ["50 %", "100 %", "75 %"]
    assert lines[0][-1].startswith("-10.0 [") and lines[1][-1].startswith("+0.0 [")
    assert lines[2][-3] == "20.0 / 80.0 / 65.0"


def test_rows_that_are_no_second_choice_are_refused():
    with pytest.raises(ValueError, match="one method"):
        Pair(section(**SEARCHED), section(tuned=(9, 5), other=(9, 5)))
    with pytest.raises(ValueError, match="another task or agent"):
        Pair(section(**SEARCHED), section(who="b", tuned=(9, 5)))
