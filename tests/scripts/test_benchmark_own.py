"""How long a training takes: a line for each configuration and its cameras, hours by the configuration's own steps."""

import sys

import yaml

from scripts import benchmark_own
from tests.builders import FLOW
from tests.report.test_markdown import tables


def test_each_line_says_what_its_configuration_takes(monkeypatch, capsys):
    small = {key: FLOW[key] for key in ("width", "depth", "context_dim", "time_dim", "heads")}
    read, timed = benchmark_own.configured, []

    def configured(name):
        own = read(name)
        return own | {"batch_size": 2, "policy": own["policy"] | small | {"samples_per_item": 1}}

    def seconds(own, cameras, size, steps):
        assert measure(own, cameras, size, steps) > 0
        timed.append((own["policy"]["chunk_size"], cameras, size, steps))
        return 1.5 * len(timed)

    measure = benchmark_own.step_seconds
    monkeypatch.setattr(benchmark_own, "configured", configured)
    monkeypatch.setattr(benchmark_own, "step_seconds", seconds)
    monkeypatch.setattr(benchmark_own, "CAMERAS", {"state": [(0, 0)], "cameras": [(2, 64)]})
    monkeypatch.setattr(sys, "argv", ["benchmark_own.py", "--steps=1"])
    benchmark_own.main()
    assert timed == [(10, 0, 0, 1), (10, 2, 64, 1)]
    (table,) = tables(capsys.readouterr().out)
    for name, expected in (("state", 1.5), ("cameras", 3.0)):
        steps = yaml.safe_load((benchmark_own.CONFIGS / f"{name}.yaml").read_text())["steps"]
        assert table[f"{name}.yaml", "--steps"] == str(steps)
        assert table[f"{name}.yaml", "all of them, hours"] == f"{expected * steps / 3600:.1f}"
