from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.matrix import Method, Setting, Task
from lerobot_gloves.benchmark.matrix_file import merged
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.benchmark.search import check_search, describe, ranking, write_chosen
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.tasks.slalom import SlalomEnv

SETTINGS = [
    Setting(editor="feeg:start=0.1"),
    Setting(editor="feeg:start=0.2", alpha=0.1),
    Setting(editor="feeg:start=0.3"),
]
TASK = Task(
    env=SlalomEnv(),
    agent="a",
    perturbations={"noised": "noised:sigma=0.005", "slow": "slow"},
    methods={"agent": Method(), "FEEG+gate": Method(adapter="b", gate=True, settings=SETTINGS)},
)
TASKS = {"slalom": TASK}


def rows(perturbation: str, column: str, *successes: list[int]) -> list[Row]:
    """One for each seed, as the matrix labels them: what is called what it is has no label."""
    label = perturbation if TASK.perturbations[perturbation] != perturbation else ""
    cell = Cell(TASK.perturbations[perturbation], "...", 0, task="slalom", perturbation_label=label, label=column)
    return [
        Row(
            cell=replace(cell, seed=seed),
            conditions={},
            episodes=tuple(Episode(i, success=bool(success)) for i, success in enumerate(here)),
        )
        for seed, here in enumerate(successes)
    ]


SEEDS = [0, 1]
ROWS = [
    *rows("noised", "FEEG+gate (feeg:start=0.1)", [1, 0], [0, 0]),
    *rows("slow", "FEEG+gate (feeg:start=0.1)", [1, 1], [1, 0]),
    *rows("noised", "FEEG+gate (feeg:start=0.2, alpha 0.1)", [1, 1], [1, 0]),
    *rows("slow", "FEEG+gate (feeg:start=0.2, alpha 0.1)", [1, 1], [0, 0]),
    *rows("noised", "FEEG+gate (feeg:start=0.3)", [1, 1], [1, 1]),
    *rows("slow", "FEEG+gate (feeg:start=0.3)", [1, 1]),
    *rows("noised", "agent", [1, 1], [1, 1]),
]


def test_ranked_by_the_mean_over_perturbations() -> None:
    """25 and 75 %; 75 and 50 %; the third was not finished, and the raw agent has nothing to choose."""
    found = ranking(TASKS, ROWS, SEEDS)
    assert list(found) == [("slalom", "FEEG+gate")]
    first, second = found["slalom", "FEEG+gate"]
    assert (first.setting, first.success, first.mean) == (SETTINGS[1], {"noised": 0.75, "slow": 0.5}, 0.625)
    assert (second.setting, second.success, second.mean) == (SETTINGS[0], {"noised": 0.25, "slow": 0.75}, 0.5)


def test_other_seeds_rows_do_not_count() -> None:
    """Of seed 0 alone: 50 and 100 %, 100 and 100 %, 100 and 100 %; equals stay in the order of the file."""
    tried = ranking(TASKS, ROWS, [0])["slalom", "FEEG+gate"]
    assert [(one.setting, one.mean) for one in tried] == [(SETTINGS[1], 1.0), (SETTINGS[2], 1.0), (SETTINGS[0], 0.75)]


def test_description() -> None:
    lines = describe(ranking(TASKS, ROWS, SEEDS)).splitlines()
    assert lines[0] == "slalom, FEEG+gate: success in % on validation seeds, best first."
    assert [[cell.strip() for cell in line.strip("|").split("|")] for line in (lines[2], *lines[4:])] == [
        ["setting", "mean", "noised", "slow"],
        ["feeg:start=0.2, alpha 0.1", "62.5", "75.0", "50.0"],
        ["feeg:start=0.1", "50.0", "25.0", "75.0"],
    ]


def test_the_best_is_written_as_the_benchmark_takes_it(tmp_path: Path) -> None:
    path = tmp_path / "new" / "chosen.yaml"
    write_chosen(path, ranking(TASKS, ROWS, SEEDS), episodes=4)
    chosen = yaml.safe_load(path.read_text())["tasks"]
    assert chosen == {"slalom": {"methods": {"FEEG+gate": {"editor": "feeg:start=0.2", "alpha": 0.1}}}}
    assert "# mean 62.5 (noised 75.0, slow 50.0), best of 2\n" in path.read_text()
    assert "4 validation episodes" in path.read_text()
    file = {"slalom": {"agent": "a", "methods": {"agent": {}, "FEEG+gate": {"adapter": "b", "alpha": 0.05}}}}
    assert merged(file, chosen, "chosen.yaml")["slalom"]["methods"] == {
        "agent": {},
        "FEEG+gate": {"adapter": "b", "editor": "feeg:start=0.2", "alpha": 0.1},
    }


def test_a_search_keeps_to_validation_seeds_and_to_its_budget() -> None:
    assert check_search(TASKS, "validation", [0, 1], 30)
    with pytest.raises(ValueError, match="a search on the test split: settings are chosen with --split=validation"):
        check_search(TASKS, "test", [0], 60)
    with pytest.raises(ValueError, match="a search with 2 seeds of 31 episodes: it may play at most 60"):
        check_search(TASKS, "validation", [0, 1], 31)
    assert not check_search({"slalom": replace(TASK, methods={"agent": Method()})}, "test", [0, 1, 2], 100)
