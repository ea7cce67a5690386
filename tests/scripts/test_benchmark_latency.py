"""How long a correction takes: a line for each editor, of corrections alone, and which are too long for a period."""

import sys

import pytest

from scripts import benchmark_latency
from tests.report.test_markdown import tables


def test_each_line_is_of_what_its_editor_took(monkeypatch, capsys):
    played = set()

    def planned(robot, count, **options):
        corrections, whole = measure(robot, 1, **options)
        played.add(options.get("method", "none"))
        # The agent's own planning counts only where nothing corrects.
        assert (corrections == [0.0]) == (not options) and whole[0] > corrections[0]
        return ([20.0] * 199 + [70.0], [1.0]) if options else ([0.0], [30.0])

    measure = benchmark_latency.planned
    monkeypatch.setattr(benchmark_latency, "planned", planned)
    monkeypatch.setattr(benchmark_latency, "SEEN", {"state": (0, 0)})
    chosen = ("copilot + gate", "CSA")
    monkeypatch.setattr(benchmark_latency, "EDITORS", {name: benchmark_latency.EDITORS[name] for name in chosen})
    monkeypatch.setattr(sys, "argv", ["benchmark_latency.py", "--period=60"])
    benchmark_latency.main()
    (table,) = tables(capsys.readouterr().out)
    assert table["the agent alone", "state"] == "30, 30"
    assert {table[name, "state"] for name in chosen} == {"20, 20"}, "the 99th percentile of two hundred is not the last"
    assert benchmark_latency._cell([10.0, 10.0, 70.0], 60.0) == "10, 69 (over)"
    assert played == {"none", "copilot:limit=0.4", "csa"}


def test_a_robot_sees_its_state_and_through_its_cameras(tmp_path):
    robot = benchmark_latency.Robot(tmp_path, 2, 32)
    (seen,) = robot.observations(1)
    shapes = {"observation.state": (1, 7), "observation.goal": (1, 1)} | {
        f"observation.images.{i}": (1, 3, 32, 32) for i in range(2)
    }
    assert {key: tuple(value.shape) for key, value in seen.items()} == shapes
    with pytest.raises(FileNotFoundError):
        robot.save("no such configuration")
