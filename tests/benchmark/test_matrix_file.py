"""The file as arguments: what it says, what goes over it, and what is refused, in one line that names the place."""

import json
from pathlib import Path
from typing import Any

import pytest

from lerobot_gloves.benchmark.matrix_file import complete
from lerobot_gloves.commands.bench import BenchConfig

TEXT = """
seeds: [0, 1]
tasks:
  slalom:
    env: {type: gloves_slalom, obs_type: state}
    agent: my/agent
    perturbations: {none: none, noised: "noised:sigma=0.005"}
    methods:
      agent: {editor: none}
      FEEG+gate: {adapter: my/adapter, editor: "feeg:start=0.2", gate: true}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "bench.yaml"
    path.write_text(TEXT)
    return path


def tasks(*arguments: str) -> dict[str, Any]:
    (text,) = [one for one in complete(arguments, BenchConfig) if one.startswith("--tasks=")]
    return json.loads(text.removeprefix("--tasks="))


def test_other_arguments_stay(file: Path) -> None:
    assert complete(["--seeds=[1]", "--output_dir=x"], BenchConfig) == ["--seeds=[1]", "--output_dir=x"]
    assert complete(["--seeds=[1]", f"--config_path={file}"], BenchConfig)[:2] == [
        "--seeds=[1]",
        f"--config_path={file}",
    ]
    file.write_text("seeds: [3]\nagent: a\n")
    assert complete([f"--config_path={file}"], BenchConfig) == [f"--config_path={file}"]


def test_options_override_what_is_in_tasks(file: Path) -> None:
    plain = tasks(f"--config_path={file}")
    changed = tasks(
        f"--config_path={file}",
        "--tasks.slalom.agent=other/agent",
        "--tasks.slalom.env.episode_length=20",
        "--tasks.slalom.methods.FEEG+gate.alpha=0.1",
        "--tasks.slalom.perturbations.slow=slow:alpha=0.25",
    )
    plain["slalom"]["agent"] = "other/agent"
    plain["slalom"]["env"]["episode_length"] = 20
    plain["slalom"]["methods"]["FEEG+gate"]["alpha"] = 0.1
    plain["slalom"]["perturbations"]["slow"] = "slow:alpha=0.25"
    assert changed == plain


@pytest.mark.parametrize("by_option", [False, True])
def test_chosen_settings_go_over_the_file_and_options_over_them(file: Path, tmp_path: Path, by_option: bool) -> None:
    chosen = tmp_path / "chosen.yaml"
    chosen.write_text('tasks: {slalom: {methods: {FEEG+gate: {editor: "feeg:start=0.7", alpha: 0.3}}}}')
    if not by_option:
        file.write_text(f"chosen: {chosen}\n{TEXT}")
    options = [f"--config_path={file}", *([f"--chosen={chosen}"] if by_option else [])]
    assert tasks(*options, "--tasks.slalom.methods.FEEG+gate.alpha=0.1")["slalom"]["methods"]["FEEG+gate"] == {
        "adapter": "my/adapter",
        "editor": "feeg:start=0.7",
        "gate": True,
        "alpha": 0.1,
    }


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("seeds:", "seds:", "bench.yaml has no key 'seds': choose from output_dir, tasks, "),
        (
            "agent: my/agent",
            "agnt: my/agent",
            "tasks.slalom has no key 'agnt': choose from env, agent, perturbations, meth",
        ),
        ("    agent: my/agent\n", "", "tasks.slalom lacks the key 'agent'"),
        (
            "gate: true",
            "gat: true",
            "tasks.slalom.methods.FEEG+gate has no key 'gat': choose from adapter, editor, gate, ",
        ),
        ("{editor: none}", "", "tasks.slalom.methods.agent is None, but must have some of the keys adapter, editor, "),
        (
            "gate: true",
            "settings: [{start: 0.1}]",
            "FEEG+gate.settings has no key 'start': choose from editor, score, alpha",
        ),
        ("gloves_slalom", "slalom", "tasks.slalom.env: unknown type 'slalom': choose from "),
        (
            '{none: none, noised: "noised:sigma=0.005"}',
            "[none]",
            "perturbations is ['none'], but must be at least one by",
        ),
        ("tasks:", "tasks: [1]\nother:", "has no key 'other'"),
        ("tasks:\n  slalom:", "tasks:\n  - slalom:", "tasks is [{"),
        (
            "{none: none,",
            "{none: ,",
            "bench.yaml: tasks.slalom.perturbations.none is None, but must be none or a specification such as noised",
        ),
        (
            "{editor: none}",
            "{editor: }",
            "tasks.slalom.methods.agent.editor is None, but must be none or an editor such as feeg",
        ),
        ("gate: true", "settings: {editor: feeg}", "FEEG+gate.settings is {'editor': 'feeg'}, but must be a list"),
        (
            "agent: {editor: none}",
            "agent: {editor: none, editor: feeg}",
            "bench.yaml, line 9: the key 'editor' is ther",
        ),
        ("tasks:", "seeds: [3]\ntasks:", "bench.yaml, line 3: the key 'seeds' is there twice"),
        ("    methods:", "    agent: b\n    methods:", "bench.yaml, line 8: the key 'agent' is there twice"),
        ("    methods:", "    methods", "bench.yaml is not YAML: while scanning a simple key"),
        (TEXT, "just words", "bench.yaml does not hold names and values"),
    ],
)
def test_wrong_files_are_refused(file: Path, before: str, after: str, message: str) -> None:
    assert before in TEXT
    file.write_text(TEXT.replace(before, after))
    with pytest.raises(ValueError) as refused:
        complete([f"--config_path={file}"], BenchConfig)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tasks: [slalom]", "chosen.yaml: tasks is ['slalom'], but must be tasks by name"),
        ("tasks: {slalom: [1]}", "chosen.yaml: tasks.slalom is [1], but must have some of the keys env, agent, pertur"),
        (
            "tasks: {slalom: {methods: [FEEG]}}",
            "chosen.yaml: tasks.slalom.methods is ['FEEG'], but must be at least on",
        ),
        (
            "tasks: {slalom: {methods: {FEEG+gate: {editr: feeg}}}}",
            "chosen.yaml: tasks.slalom.methods.FEEG+gate has no key 'editr': choose from adapter, editor, gate, ",
        ),
        ("tasks: {slalom: {methods: {FEG: {editor: feeg}}}}", "chosen.yaml: slalom has no method 'FEG': choose from a"),
        ("tasks: {keypad: {}}", "chosen.yaml: there is no task 'keypad': choose from slalom"),
        ("tasks: {}\nseeds: [1]", "chosen.yaml has no key 'seeds': a file of chosen settings holds tasks only"),
        ("tasks: {}\ntasks: {}", "chosen.yaml, line 2: the key 'tasks' is there twice"),
        ("[1]", "chosen.yaml does not hold names and values"),
    ],
)
def test_wrong_chosen_files_are_refused_by_their_own_name(file: Path, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "chosen.yaml").write_text(text)
    with pytest.raises(ValueError) as refused:
        complete([f"--config_path={file}", f"--chosen={tmp_path / 'chosen.yaml'}"], BenchConfig)
    assert message in str(refused.value)
    assert "bench.yaml" not in str(refused.value) and "\n" not in str(refused.value)


def test_several_mappings_may_be_merged_from_below(file: Path) -> None:
    """YAML's own `<<` is not one key twice."""
    anchored = TEXT.replace("agent: {editor: none}", "a: &a {editor: none}\n      b: &b {alpha: 0.1}").replace(
        "adapter: my/adapter,", "<<: *a, <<: *b, adapter: my/adapter,"
    )
    file.write_text(anchored)
    method = tasks(f"--config_path={file}")["slalom"]["methods"]["FEEG+gate"]
    assert method == {"alpha": 0.1, "adapter": "my/adapter", "editor": "feeg:start=0.2", "gate": True}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--tasks.slalom=5", "--tasks.slalom=5: tasks.slalom is 5, but must have some of the keys env, agent, "),
        ("--tasks.slalom.perturbations.noised=", "tasks.slalom.perturbations.noised is None, but must be none or a "),
        ("--tasks.slalm.agent=a", "--tasks.slalm.agent=a: there is no task 'slalm': choose from slalom"),
        ("--tasks.slalom.methods.FEG.alpha=1", "slalom has no method 'FEG': choose from agent, FEEG+gate"),
        ("--tasks.slalom.agnt=a", "tasks.slalom has no key 'agnt'"),
        ("--tasks.slalom.agent", "--tasks.slalom.agent has no value: write --tasks.slalom.agent=VALUE"),
    ],
)
def test_wrong_overrides_are_refused(file: Path, option: str, message: str) -> None:
    with pytest.raises(ValueError) as refused:
        complete([f"--config_path={file}", option], BenchConfig)
    assert message in str(refused.value)
    with pytest.raises(ValueError, match="overrides a task of a file: name the file by --config_path"):
        complete([option], BenchConfig)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none\.yaml"):
        complete([f"--config_path={tmp_path / 'none.yaml'}"], BenchConfig)
