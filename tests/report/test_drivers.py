"""The drivers' table against figures worked out by hand."""

import pytest

from lerobot_gloves.report.drivers import drivers_table
from lerobot_gloves.report.statistics import newcombe, wilson


def row(setting: str, seed: int, success: bool, failure: str = "", **other) -> dict:
    own = {"task": "slalom", "driver": "beginner", "setting": setting, "seed": seed, "began": None}
    return {
        **own,
        "success": success,
        "failure": failure,
        "steps": 100,
        "commands": 50,
        "changed": 0,
        "moved": 0.0,
        "crept": 0,
    } | other


ROWS = [
    *(row("raw", seed, seed < 4, "" if seed < 4 else "collision") for seed in range(10)),
    *(
        row("copilot", seed, seed < 7, "" if seed < 7 else "wrong_corridor", changed=25, moved=0.2)
        for seed in range(10)
    ),
]


def test_a_setting_stands_beside_the_same_drivers_alone():
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in drivers_table(ROWS).splitlines()[2:]]
    assert [line[:3] for line in lines] == [
        ["slalom", "beginner", "raw"],
        ["slalom", "beginner", "copilot"],
        ["all", "all", "raw"],
        ["all", "all", "copilot"],
    ]
    low, high = wilson(7, 10)
    assert lines[1][3] == f"70 % ({100 * low:.0f} to {100 * high:.0f})"
    low, high = newcombe(4, 3, 0, 3)
    assert lines[1][4] == f"+30 ({100 * low:+.0f} to {100 * high:+.0f})" and lines[0][4] == "-"
    assert lines[1][5:] == ["70 %", "100", "50 %", "20 %", "0", "wrong corridor 3"]
    assert lines[0][5:] == ["100 %", "100", "0 %", "0 %", "0", "collision 6"]
    assert lines[2][3:] == lines[0][3:] and lines[3][3:] == lines[1][3:]


def test_other_seeds_are_no_pairs():
    with pytest.raises(ValueError, match="slalom, copilot: not played on the seeds of the drivers alone"):
        drivers_table([*ROWS, row("copilot", 10, True)])
