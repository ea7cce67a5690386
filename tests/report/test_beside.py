"""The copilot beside its agents: means, leads and distances counted by hand."""

from types import SimpleNamespace

import pytest

from lerobot_gloves.report.beside import AllBeside, Beside, natural_table
from lerobot_gloves.report.paper import COLUMNS


def section(name, who, **successes):
    """One task; by method, success in % under none, laggy and noised."""
    results = {}
    for method, rates in successes.items():
        for kind, rate, raw in zip(("none", "laggy", "noised"), rates, successes["agent"], strict=True):
            gain = (rate - raw) / 100
            difference = SimpleNamespace(mean=gain, low=gain - 0.1, high=gain + 0.1)
            results[kind, method] = SimpleNamespace(mean=rate / 100, difference=difference)
    kinds = {"none": "none", "laggy": "laggy:p=1", "noised": "noised:sigma=1"}
    return SimpleNamespace(name=name, shared={"agent": who}, perturbations=kinds, results=results)


def columns(**successes):
    return dict.fromkeys(COLUMNS, (90, 10, 20)) | successes


@pytest.fixture
def beside():
    table = section("slalom", "a", **columns(CSA=(97, 60, 70)))
    other = section("can", "b", **columns(IFAE=(99, 50, 95)))
    one = Beside(section("slalom", "a", agent=(90, 10, 20), copilot=(92, 60, 90)), table)
    return AllBeside([one, Beside(section("can", "c", agent=(95, 20, 30), copilot=(90, 25, 80)), other)])


def test_means_are_over_the_cells_of_all_tasks(beside):
    assert beside.count == 4
    assert beside.mean("copilot") == pytest.approx((60 + 90 + 25 + 80) / 4)
    assert beside.mean("agent") == pytest.approx((10 + 20 + 20 + 30) / 4), "those beside which it was played"
    assert beside.mean("CSA") == pytest.approx((60 + 70 + 10 + 20) / 4)


def test_leads_and_distances_are_to_the_best_of_the_other_columns(beside):
    assert beside.leads == 2, "a tie and a lead"
    assert beside.furthest == pytest.approx(25), "25 where IFAE has 50"
    assert beside.ahead("CSA") == 3 and beside.ahead("IFAE") == 2
    assert beside.above_raw == 3, "+50, +70 and +50, but +5 within its interval"
    assert beside.lowest_unperturbed == pytest.approx({"slalom": -8, "can": -15})


def test_the_table_says_whose_agents_are_others(beside):
    table = beside.table()
    assert table.caption.endswith(
        "On can those of the table above are of another training of the agent by the same command."
    )
    lines = [[entry.text for entry in line] for line in table.lines]
    assert lines[0][:2] == ["mean of 4", "20.0"] and lines[0][-1].endswith(" (IFAE)")
    assert lines[1] == ["slalom, laggy", "10.0", "60.0", "+50.0 [+40.0, +60.0]", "60.0 (CSA)"]
    assert [line[0] for line in lines[5:]] == ["slalom, nothing perturbed", "can, nothing perturbed"]
    assert lines[6][1:] == ["95.0", "90.0", "-5.0 [-15.0, +5.0]", "99.0 (IFAE)"]
    assert "another training" not in AllBeside(beside.tasks[:1]).table().caption


def test_a_column_that_was_played_beside_the_copilot_counts_as_it_was_there(beside):
    played = section("can", "c", agent=(95, 20, 30), copilot=(90, 25, 80), IFAE=(95, 20, 85))
    beside = AllBeside([beside.tasks[0], Beside(played, beside.tasks[1].table)])
    assert beside.tasks[1].best("laggy") == ("agent", 20) and beside.tasks[1].best("noised") == ("IFAE", 85)
    assert beside.leads == 3 and beside.furthest == pytest.approx(5) and beside.ahead("IFAE") == 3
    assert beside.mean("IFAE") == pytest.approx((10 + 20 + 20 + 85) / 4)
    assert beside.table().caption.endswith("by the same command, but IFAE of the copilot's.")


def test_agents_imperfect_by_nature_stand_in_one_table():
    def agent(raw, **corrected):
        played = section("x", "a", agent=(raw, 0, 0), **{name: (rate, 0, 0) for name, rate in corrected.items()})
        played.methods = ["agent", *corrected]
        return played

    sections = {"short": agent(80, mended=85), "few": agent(50, mended=53)}
    others = {"short": agent(80, FEEG=70, CSA=82), "few": agent(50, CSA=60)}
    table = natural_table(sections, others)
    lines = [[entry.text for entry in line] for line in table.lines]
    assert table.header == ["agent", "raw", "CSA", "FEEG", "copilot", "copilot minus raw"]
    assert lines[0] == ["short", "80.0", "82.0", "70.0", "85.0", "+5.0 [-5.0, +15.0]"]
    assert lines[1][:5] == ["few", "50.0", "60.0", "–", "53.0"]
    assert lines[2] == ["mean", "65.0", "71.0", "–", "69.0", "+4.0"]
    alone = natural_table(sections, {})
    assert [entry.text for entry in alone.lines[2]] == ["mean", "65.0", "69.0", "+4.0"]
