"""The shipped matrices: valid to the last option, though their checkpoints are not here."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import draccus
import pytest
from lerobot.policies import get_policy_class

import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.benchmark import plan as planning
from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.matrix import cells
from lerobot_gloves.benchmark.matrix_file import complete
from lerobot_gloves.benchmark.search import check_search
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.commands.bench import BenchConfig
from lerobot_gloves.evaluation.agent import resolve_perturbation
from lerobot_gloves.report.paper import COLUMNS
from lerobot_gloves.specification import parse
from scripts import train_metaworld

BASELINES = ("DDPM", "CSA")
EPISODES = {"can": 30, "charger": 30}
"""Of a search under each perturbation, where that is not 60: theirs are long."""
ROOT = Path(__file__).parents[2]
BENCH = ROOT / "configs" / "bench"
TYPES = {
    "expert_flow": "gloves_expert_flow",
    "align_flow": "gloves_align_flow",
    "ddpm_assist": "ddpm_assist",
    "csa_student": "csa_assist",
    "copilot": "gloves_copilot",
}


def read(name: str) -> BenchConfig:
    arguments = complete([f"--config_path={BENCH / name}", "--output_dir=x"], BenchConfig)
    return draccus.parse(BenchConfig, config_path=BENCH / name, args=[a for a in arguments if "config_path" not in a])


def check(setup: Setup, cell: Cell) -> None:
    """The editor and the score are the adapter's, whose type its folder's name tells."""
    if setup.adapter is None:
        assert cell.raw
        return
    adapter = get_policy_class(TYPES[Path(setup.adapter).parts[2]])
    parse(cell.editor, adapter.editors, "method")
    if adapter.scores:
        parse(setup.score or next(iter(adapter.scores)), adapter.scores, "score")
    else:
        assert setup.score is None and not cell.gate


TASKS = {"slalom": 30, "keypad": 30, "can": 32, "charger": 20}
"""Episodes of a seed in the paper."""
BENCHMARKS = [*TASKS, "charger_hidden", "slalom_pixels", "can_pixels"]
FILES = [f"{benchmark}{kind}.yaml" for benchmark in BENCHMARKS for kind in ("", "_search")]
ABLATIONS = [f"../ablations/{name}.yaml" for name in ("feeg_align", "training_seeds", *(f"natural_{t}" for t in TASKS))]


@pytest.mark.parametrize("name", [*FILES, "metaworld.yaml", *ABLATIONS])
def test_every_cell_is_valid(name: str) -> None:
    config = read(name)
    shared = {"split": config.split, "episodes": config.episodes, "batch_size": config.batch_size}
    seen = set()
    for setup, cell in cells(config.matrix(), config.seeds, **shared):
        resolve_perturbation(cell.perturbation)
        if (cell.task, cell.column) not in seen:
            check(setup, cell)
        seen.add((cell.task, cell.column))


def test_metaworld_plays_every_agent_a_hundred_times_and_names_what_its_script_makes() -> None:
    config = read("metaworld.yaml")
    assert len(config.seeds) * config.episodes == 100
    made = {str(run.checkpoint) for run in train_metaworld.agents()}
    named = {task.agent for task in config.tasks.values()}
    assert named == {*made, str(train_metaworld.train("expert_flow", "expert_flow").checkpoint)}
    assert {task.env.task for task in config.tasks.values()} == set(train_metaworld.TASKS)
    assert {path.stem for path in (ROOT / "configs" / "metaworld").glob("*.yaml")} == {
        *("act", "act_large", "diffusion", "multi_task_dit", "expert_flow", "copilot", "csa_teacher", "csa_student")
    }


@pytest.mark.parametrize(("task", "episodes"), TASKS.items())
def test_the_benchmark_has_the_papers_columns_and_the_copilots_on_ten_seeds(task: str, episodes: int) -> None:
    config = read(f"{task}.yaml")
    assert list(config.tasks[task].methods) == [*COLUMNS, "copilot"]
    assert (config.seeds, config.episodes, config.split) == (list(range(10)), episodes, "test")


def test_the_ablation_is_the_benchmark_with_the_receptacle_hidden() -> None:
    ablation, benchmark = read("charger_hidden.yaml"), read("charger.yaml")
    assert (ablation.seeds, ablation.episodes, ablation.split) == (benchmark.seeds, benchmark.episodes, benchmark.split)
    hidden, shown = ablation.tasks["charger"], benchmark.tasks["charger"]
    assert hidden.env == replace(shown.env, hide_receptacle=True)
    assert hidden.perturbations == shown.perturbations
    for label, method in hidden.methods.items():
        assert method.gate == shown.methods[label].gate
        assert method.editor.partition(":")[0] == shown.methods[label].editor.partition(":")[0]


@pytest.mark.parametrize("name", ["slalom", "keypad"])
def test_other_trainings_are_used_as_the_benchmarks_are(name: str) -> None:
    config = read("../ablations/training_seeds.yaml").tasks[name]
    benchmark = read(f"{name}.yaml").tasks[name]
    assert (config.env, config.agent) == (benchmark.env, benchmark.agent)
    assert config.perturbations.items() <= benchmark.perturbations.items()
    assert len(config.perturbations) == 5
    for method in ("copilot", "CSA", "FEEG+gate", "IFAE"):
        own = benchmark.methods[method]
        for seed in (1, 2):
            other = config.methods[f"{method} {seed}"]
            assert Path(other.adapter).parts[1] == f"{name}_seed{seed}"
            assert replace(other, adapter=own.adapter) == own
    assert len(config.methods) == 8


@pytest.mark.parametrize("name", TASKS)
def test_agents_imperfect_by_nature_are_corrected_as_the_search_chose_for_the_perturbed(name: str) -> None:
    config, benchmark = read(f"../ablations/natural_{name}.yaml"), read(f"{name}.yaml")
    assert (config.seeds, config.episodes, config.split) == (benchmark.seeds, benchmark.episodes, "test")
    for kind in ("short", "few"):
        task = config.tasks[f"{name}_{kind}"]
        assert f"--agent={task.agent} " in (ROOT / "docs" / "rows" / f"{name}_{kind}" / "note.md").read_text()
        assert task.perturbations == {"none": "none"}
        assert list(task.methods) == ["DDPM", "CSA", "FEEG", "FEEG+gate"]
        for label, method in task.methods.items():
            assert method == benchmark.tasks[name].methods[label]


@pytest.mark.parametrize("name", TASKS)
def test_the_ablation_of_feeg_is_the_benchmark_with_and_without_the_pull_back(name: str) -> None:
    ablation, benchmark = read("../ablations/feeg_align.yaml").tasks[name], read(f"{name}.yaml").tasks[name]
    assert ablation.agent == benchmark.agent
    assert ablation.perturbations.items() <= benchmark.perturbations.items()
    assert set(ablation.perturbations) == {"laggy", "noised", "slow", "shift"}
    start = benchmark.methods["FEEG"].editor.partition(",")[0]
    assert {label: method.editor for label, method in ablation.methods.items()} == {
        "align 0": f"{start},align=0.0",
        "align 1": f"{start},align=1.0",
    }
    assert {method.adapter for method in ablation.methods.values()} == {benchmark.methods["FEEG"].adapter}


@pytest.mark.parametrize("name", BENCHMARKS)
def test_the_search_gives_no_method_more_than_the_baselines(name: str) -> None:
    config, benchmark = read(f"{name}_search.yaml"), read(f"{name}.yaml")
    ((key, task),) = config.tasks.items()
    assert check_search(config.tasks, config.split, config.seeds, config.episodes)
    assert len(config.seeds) * config.episodes == EPISODES.get(key, 60)
    # The ablation has no baselines of its own.
    searched = read(f"{key}_search.yaml").tasks[key].methods
    least = min(len(searched[baseline].settings) for baseline in BASELINES)
    for label, method in task.methods.items():
        assert label in BASELINES or len(method.settings) <= least, label
        assert (label == COLUMNS[0]) == (not method.settings), label
        # What is chosen here is for the same method there.
        other = benchmark.tasks[key].methods[label]
        assert (method.adapter, method.gate, method.options) == (other.adapter, other.gate, other.options)
    assert task.perturbations.items() <= benchmark.tasks[key].perturbations.items()


def test_the_published_rows_are_those_of_the_shipped_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run again beside them, it would find nothing to play; their checkpoints are taken at the rows' word."""
    folder = ROOT / "docs" / "rows" / "slalom"
    hashes = {
        row.checkpoints[role]: row.conditions[role]
        for row in read_rows(folder)
        for role in ("agent", "adapter")
        if row.checkpoints[role]
    }

    def config(option: str, checkpoint: str, overrides: Sequence[str] = ()) -> SimpleNamespace:
        return SimpleNamespace(type=TYPES.get(Path(checkpoint).parts[2]))

    monkeypatch.setattr(planning, "checkpoint_hash", hashes.__getitem__)
    for module in ("plan", "setup"):
        monkeypatch.setattr(f"lerobot_gloves.benchmark.{module}.checkpoint_config", config)
    monkeypatch.chdir(ROOT)  # which `chosen` is relative to
    matrix = read("slalom.yaml")
    shared = {"split": matrix.split, "episodes": matrix.episodes, "batch_size": matrix.batch_size}
    jobs = planning.plan(cells(matrix.matrix(), matrix.seeds, **shared))
    assert planning.finished_cells(folder, jobs) == {job.cell for job in jobs}
    assert len(jobs) == len(read_rows(folder)) == 630
