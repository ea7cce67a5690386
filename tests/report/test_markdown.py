"""Every figure of the tables, against hand-counted episodes."""

import re
from copy import deepcopy
from statistics import stdev

import pytest

from lerobot_gloves.report.markdown import report_markdown
from lerobot_gloves.report.statistics import paired_difference, wilson
from tests.benchmark.rows import ROWS, labelled, loaded, row

TOLD = "what it is told"


def report(rows: list[dict], *, paper: bool = False) -> str:
    return report_markdown(loaded(rows), paper=paper)


def tables(text: str) -> list[dict[tuple[str, str], str]]:
    """The tables of a report, by perturbation and method."""
    found = []
    for block in re.findall(r"(?:^\|.*\n?)+", text, flags=re.M):
        header, _, *lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in block.splitlines()]
        found.append({(line[0], method): cell for line in lines for method, cell in zip(header, line, strict=True)})
    return found


def columns(table: dict[tuple[str, str], str]) -> list[str]:
    """The headers of a table without the first, in their order."""
    return list(dict.fromkeys(method for _, method in table))[1:]


def lines(table: dict[tuple[str, str], str]) -> list[str]:
    """The heads of a table's lines, without what its columns are told."""
    return [head for head in dict.fromkeys(perturbation for perturbation, _ in table) if head != TOLD]


def test_success() -> None:
    success, *_ = tables(report(ROWS))
    low, high = wilson(5, 8)
    assert success["slow", "feeg+gate"] == f"**62.5 ± {stdev([50, 75]):.1f} [{100 * low:.1f}, {100 * high:.1f}]**"
    low, high = wilson(2, 8)
    assert success["slow", "agent"] == f"25.0 ± 0.0 [{100 * low:.1f}, {100 * high:.1f}]"
    low, high = wilson(4, 4)
    expected = f"100.0 [{100 * low:.1f}, 100.0] (1 of 2 seeds)"
    assert success["none", "agent"] == expected, "one seed has no deviation, and no rival"
    assert success["none", "feeg+gate"] == "–", "not run"


def test_best_and_second_best_are_marked() -> None:
    """Of 25, 50, 50 and 75 %; a second best needs a third, and equals share their mark."""
    rows = [
        row("slow", "none", 0, [0, 1, 0, 0]),
        row("slow", "feeg", 0, [0, 1, 1, 0]),
        row("slow", "fpas", 0, [1, 0, 1, 0]),
        row("slow", "ifae", 0, [1, 1, 1, 0]),
    ]
    success, *_ = tables(report(rows))
    marks = {name: re.sub(r"[^*_]", "", success["slow", name]) for name in ("agent", "feeg", "fpas", "ifae")}
    assert marks == {"agent": "", "feeg": "__", "fpas": "__", "ifae": "****"}
    success, *_ = tables(report(rows[:2]))
    assert success["slow", "feeg"].startswith("**50.0") and success["slow", "agent"].startswith("25.0")
    success, *_ = tables(report(rows[1:3]))
    assert success["slow", "feeg"].startswith("50.0") and success["slow", "fpas"].startswith("50.0"), "nobody is best"


def test_an_unfinished_benchmark_says_so_and_marks_nobody() -> None:
    """The raw agent's second seed is missing: 62.5 over both seeds is not better than 25 over one of them."""
    success, *_ = tables(report([ROWS[0], ROWS[1], ROWS[2]]))
    assert success["slow", "agent"].startswith("25.0 [") and success["slow", "agent"].endswith("] (1 of 2 seeds)")
    assert success["slow", "feeg+gate"].startswith("62.5 ± 17.7 [") and success["slow", "feeg+gate"].endswith("]")


def test_difference_to_the_raw_agent_is_paired() -> None:
    _, difference, *_ = tables(report(ROWS))
    raw, adapted = [0, 1, 0, 0, 0, 0, 1, 0], [1, 1, 0, 0, 1, 1, 1, 0]
    found = paired_difference([bool(s) for s in raw], [bool(s) for s in adapted])
    assert found.mean == pytest.approx(3 / 8)
    assert difference["slow", "feeg+gate"] == f"+37.5 [{100 * found.low:+.1f}, {100 * found.high:+.1f}], p = 0.250"
    assert columns(difference) == ["feeg+gate"]


def test_pairs_are_the_episodes_that_both_have() -> None:
    """Without the raw agent's seed 0, only seed 1 is compared; without any, nothing is."""
    _, difference, *_ = tables(report([r for r in ROWS if r is not ROWS[2]]))
    assert difference["slow", "feeg+gate"].startswith("+50.0 ")
    _, difference, *_ = tables(report([*ROWS[:2], ROWS[4]]))
    assert difference["slow", "feeg+gate"] == "–"
    assert "McNemar" not in report(ROWS[:2])


def test_edits_and_cost_are_weighed_by_chunks() -> None:
    """4 episodes of 5 chunks and 4 of 10: 16 + 8 of 60 edited, mean distance (20 x 0.4 + 40 x 0.1) / 60, and so on."""
    _, _, edits, cost, _ = tables(report(ROWS))
    assert edits["slow", "feeg+gate"] == "40.0 %; 0.200"
    assert cost["slow", "feeg+gate"] == "4.00 ms; 7.0"
    assert columns(edits) == columns(cost) == ["feeg+gate"]


def test_failures_are_shares_of_all_episodes() -> None:
    rows = deepcopy(ROWS)
    rows[2]["episodes"][0]["failure"] = "timeout"
    *_, failures = tables(report(rows))
    assert failures["slow", "agent"] == "collision 62.5, timeout 12.5", "5 and 1 of 8"
    assert failures["slow", "feeg+gate"] == "collision 37.5"
    assert failures["none", "agent"] == "0"


def test_methods_and_perturbations_stand_in_the_papers_order() -> None:
    methods = [
        "ifae+gate",
        "ifae:steps=5",
        "none",
        "csa",
        "ddpm:gamma=0.3",
        "feeg",
        "mine",
        "fpas",
        "feeg:start=0.5+gate",
    ]
    rows = [row("shift", method, 0, [1, 0, 1, 0]) for method in methods]
    rows += [
        row(kind, "none", 0, [1, 0, 1, 0]) for kind in ("slow:p=0.1", "none", "noised", "laggy:p=0.6", "laggy:p=0.2")
    ]
    success, *_ = tables(report(rows))
    expected = [
        "agent",
        "ddpm:gamma=0.3",
        "csa",
        "fpas",
        "feeg",
        "feeg:start=0.5+gate",
        "ifae:steps=5",
        "ifae+gate",
        "mine",
    ]
    assert columns(success) == expected
    assert lines(success) == ["none", "laggy:p=0.2", "laggy:p=0.6", "noised", "slow:p=0.1", "shift"]


def test_a_compound_stands_behind_the_papers_and_is_explained() -> None:
    rows = [row(kind, "none", 0, [1, 0, 1, 0]) for kind in ("shift", "none", "rotated", "noised")]
    compound = row("noised+laggy", "none", 0, [0, 0, 1, 0])
    compound["conditions"]["perturbation"] = "noised:sigma=0.005+laggy:p=0.2"
    text = report([compound, *rows], paper=True)
    success, *_ = tables(text)
    measured = [line for line in lines(success) if "published" not in line]
    assert measured == ["none", "noised", "shift", "noised+laggy", "rotated"]
    assert lines(success)[-2:] == ["noised+laggy", "rotated"], "the paper's lines of noised stand below noised"
    assert success["noised+laggy", "agent"].startswith("25.0")
    assert "- noised+laggy: noised:sigma=0.005+laggy:p=0.2" in text


def test_labels_name_lines_and_columns_and_are_explained() -> None:
    rows = [
        labelled(
            row("slow:alpha=0.5,p=0.5", "none", 0, [0, 1, 0, 0]), label="agent", perturbation_label="slow", task="s1"
        ),
        labelled(
            row("slow:alpha=0.5,p=0.5", "feeg:start=0.2+gate", 0, [1, 1, 0, 0]),
            label="FEEG+gate",
            perturbation_label="slow",
            task="s1",
        ),
    ]
    text = report(rows)
    success, *_ = tables(text)
    assert columns(success) == ["agent", "FEEG+gate"]
    assert success["slow", "FEEG+gate"].startswith("**50.0")
    assert text.startswith("## s1, test split\n")
    assert "- slow: slow:alpha=0.5,p=0.5\n- FEEG+gate: feeg:start=0.2+gate, score" in text


def test_headline_says_what_was_run() -> None:
    text = report(ROWS)
    assert "## gloves_slalom, test split" in text
    assert "task=Slalom-v0, obs_type=state; 4 episodes for each of 2 seeds, 4 side by side." in text
    assert "Agent my/agent (aaaaaaaaaaaa)." in text
    assert "- feeg+gate: feeg+gate, score reverse:steps=1, alpha 0.05, adapter my/adapter (bbbbbbbbbbbb)" in text


def test_what_an_adapter_was_told_besides_is_printed() -> None:
    """IFAE with one network for every perturbation is told which one is played; a reader must know."""
    told = row("slow", "ifae", 0, [1, 1, 1, 1])
    told["conditions"]["options"] = {
        "adapter_overrides": ["--agent_source={perturbation}", "--guidance=2"],
        "adapter_rename_map": {"observation.a": "observation.b"},
    }
    blind = row("slow", "feeg", 0, [1, 1, 1, 1])
    blind["conditions"]["options"] = {"adapter_overrides": ["--guidance=2"]}
    ifae, feeg = [line for line in report([blind, told]).splitlines() if line.startswith(("- ifae", "- feeg"))][::-1]
    assert ifae.endswith(
        "adapter my/adapter (bbbbbbbbbbbb), adapter_overrides --agent_source={perturbation} --guidance=2 "
        "(it is told the perturbation: {perturbation} is the name of the one played), "
        "adapter_rename_map observation.a as observation.b"
    )
    assert feeg.endswith("adapter my/adapter (bbbbbbbbbbbb), adapter_overrides --guidance=2")


def test_an_adapter_without_scores_is_told_without() -> None:
    baseline = row("slow", "ddpm", 0, [1, 1, 1, 1])
    baseline["conditions"] |= {"score": None, "alpha": None}
    assert "- ddpm: ddpm, adapter my/adapter (bbbbbbbbbbbb)" in report([baseline])


def test_the_papers_lines_stand_below_ours_of_the_same_kind() -> None:
    rows = [*ROWS, row("slow:alpha=0.25,p=0.75", "none", 0, [1, 0, 1, 0])]
    success, *others = tables(report(rows, paper=True))
    paper = "slow:alpha=0.5,p=0.5, published"
    assert lines(success) == ["perturbation", "none", "slow", "slow:alpha=0.25,p=0.75", paper][1:]
    assert columns(success) == ["agent", "DDPM", "CSA", "FPAS", "FEEG", "FEEG+gate", "IFAE", "IFAE+gate", "feeg+gate"]
    assert success[paper, "agent"] == "55.7 ± 5.1"
    assert success[paper, "IFAE"] == "**74.6 ± 4.6**"
    assert success[paper, "IFAE+gate"] == "_74.0 ± 4.4_"
    assert success[paper, "feeg+gate"] == "–"
    assert all(paper not in lines(other) for other in others)
    assert "tab:flowalign_best_triplet_comparison" in report(rows, paper=True)
    assert "published" not in report(rows)


def other_task(rows: list[dict]) -> list[dict]:
    changed = deepcopy(rows)
    for one in changed:
        one["conditions"]["env"]["type"] = "gloves_keypad"
    return changed


def test_several_tasks_have_sections_of_their_own_and_an_overview() -> None:
    text = report([*ROWS, *other_task(ROWS[2:])])
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## All tasks",
        "## gloves_slalom, test split",
        "## gloves_keypad, test split",
    ]
    header, _, *body = [line for line in text.split("## gloves_slalom")[0].splitlines() if line.startswith("|")]
    assert header.replace(" ", "") == "|task|perturbation|agent|feeg+gate|"
    assert [line.replace(" ", "") for line in body] == [
        "|whatitistold||nothing|nothing|",
        "|gloves_slalom,test|none|100.0(1of2seeds)|–|",
        "|gloves_slalom,test|slow|25.0±0.0|**62.5±17.7**|",
        "|gloves_keypad,test|none|100.0(1of2seeds)|–|",
        "|gloves_keypad,test|slow|25.0±0.0|–|",
    ]


def test_the_overview_has_each_line_of_the_paper_once() -> None:
    validation = deepcopy(ROWS)
    for one in validation:
        one["conditions"]["split"] = "validation"
    overview = report([*ROWS, *validation, *other_task(ROWS)], paper=True).split("## gloves_slalom")[0]
    assert overview.count("slow:alpha=0.5,p=0.5, published") == 1
    assert overview.count("slow:alpha=2.0,p=0.5, published") == 1


def test_the_raw_agent_may_be_in_several_folders() -> None:
    assert report([*ROWS, *deepcopy(ROWS[2:])]) == report(ROWS)


def test_rows_that_contradict_each_other_are_refused() -> None:
    again = deepcopy(ROWS[2])
    again["episodes"][0]["success"] = True
    with pytest.raises(ValueError, match="slow / agent / seed 0 is there twice, with different outcomes"):
        report([*ROWS, again])
    retrained = deepcopy(ROWS[0])
    retrained["conditions"]["adapter"] = "c" * 64
    with pytest.raises(ValueError, match=r"rows of 'feeg\+gate' were made in two ways"):
        report([ROWS[1], retrained])
    stronger = labelled(row("slow:p=0.9", "none", 1, [1, 1, 1, 1]), perturbation_label="slow")
    with pytest.raises(
        ValueError, match=r"rows of 'slow' were made in two ways, perturbation=slow and perturbation=slow:p=0\.9"
    ):
        report([ROWS[2], stronger])


def test_no_rows() -> None:
    with pytest.raises(ValueError, match="no rows"):
        report([])
