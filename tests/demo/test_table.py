import pytest

from lerobot_gloves.demo.evaluation import PlayedRun, Run
from lerobot_gloves.demo.table import table


def result(label, successes, chunks=()):
    return PlayedRun(Run(label, label), successes, [], [], list(chunks))


def test_every_cell():
    # Of 10 episodes raw wins 4; corrected wins 7: 4 more (episodes 4-7) and one less (episode 0).
    raw = result("raw agent", [True] * 4 + [False] * 6)
    chunks = [{"edited": True, "distance": 0.5}, {"edited": False, "distance": 0.0}] * 2
    corrected = result("FEEG", [False] + [True] * 7 + [False] * 2, chunks)
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table([raw, corrected]).splitlines()]
    # Wilson, by the textbook: n=10, 4 successes [16.8, 68.7], 7 successes [39.7, 89.2].
    assert lines[2] == ["raw agent", "40.0 [16.8, 68.7]", "–", "–", "–"]
    assert lines[3][:4] == ["FEEG", "70.0 [39.7, 89.2]", "50.0 %", "0.250"]
    # (4 - 1) / 10. Newcombe: 3 pairs won by both, 2 by neither, so the corrected correlation is 0, and the Wilson
    # distances add up squared: 30 - sqrt(30.3^2 + 28.7^2) and 30 + sqrt(19.2^2 + 23.2^2).
    assert lines[3][4] == "+30.0 [-11.8, +60.1]"


def test_it_lines_up():
    lines = table([result("a", [True]), result("a long label", [True], [{"edited": 1, "distance": 1.0}])]).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert [i for i, c in enumerate(lines[0]) if c == "|"] == [i for i, c in enumerate(lines[3]) if c == "|"]


def test_other_episodes_cannot_be_compared():
    with pytest.raises(ValueError, match="1 outcomes of one method, 2 of the other"):
        table([result("a", [True]), result("b", [True, False], [{"edited": 1, "distance": 1.0}])])
