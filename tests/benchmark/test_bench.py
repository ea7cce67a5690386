import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.commands import main


def gloves(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    """Run the command in this process; what it says at its end."""
    monkeypatch.setattr(sys, "argv", ["gloves", *arguments])
    try:
        main()
    except SystemExit as end:
        return str(end.code)
    return ""


def without_times(rows: list[Row]) -> list[Row]:
    return [
        replace(row, seconds=0.0, episodes=tuple(replace(one, milliseconds=0.0) for one in row.episodes))
        for row in rows
    ]


def test_bench_then_report(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matrix = ["--perturbations=[none, slow]", '--methods=[none, "feeg:start=0.5+gate"]', "--seeds=[0, 1]"]
    assert gloves(monkeypatch, "bench", *options, *matrix) == ""
    printed = capsys.readouterr().out
    rows = read_rows(tmp_path / "rows")
    assert len(rows) == 8
    assert {file.suffix for file in (tmp_path / "rows").iterdir()} == {".json"}, "no locks, no parts"
    assert [episode.seed for episode in rows[-1].episodes] == [10100, 10101, 10102]
    assert printed.startswith("## gloves_slalom, test split")

    assert gloves(monkeypatch, "report", f"--rows={tmp_path / 'rows'}", f"--output={tmp_path / 'new' / 'r.md'}") == ""
    assert capsys.readouterr().out == printed
    assert (tmp_path / "new" / "r.md").read_text() == printed


def test_running_again_runs_what_is_missing(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert gloves(monkeypatch, "bench", *options) == ""
    assert gloves(monkeypatch, "bench", *options, "--num_workers=2") == "", "nothing is missing"
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "rows").iterdir()}
    assert gloves(monkeypatch, "bench", *options, "--perturbations=[none, laggy]") == ""
    after = {file: file.stat().st_mtime_ns for file in (tmp_path / "rows").iterdir()}
    assert len(after) == 2 and before.items() <= after.items()
    assert "made with episodes=3" in gloves(monkeypatch, "bench", *options, "--episodes=4")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            "--perturbations=[none, nosied]",
            "unknown perturbation 'nosied': choose from chatter, deadzone, delayed, dropped, laggy, noised, none, ",
        ),
        ('--perturbations=["noised:std=1"]', "perturbation 'noised' has no option 'std': choose from sigma"),
        ("--methods=[none, feg]", "unknown method 'feg': choose from feeg, fpas, ifae, none"),
        ('--methods=["feeg:start=2"]', "FEEG: start is 2.0, but must lie in [0, 1]"),
        ("--methods=[none+gate]", "nothing that a gate could hold back"),
        ("--methods=[]", "methods is empty"),
        ("--score=likely", "unknown score 'likely': choose from likelihood, residual, reverse, selfnormalised"),
        ("--score=reverse:steps=3", "not calibrated for score 'reverse:steps=3'"),
        ("--split=train", "unknown split 'train': choose from test, validation"),
        ("--episodes=101", "episodes is 101, but must lie between 1 and 100"),
        ("--seeds=[0, 100]", "seed is 100, but must lie between 0 and 99"),
        ("--agent=no/thing", "--agent=no/thing is no checkpoint's folder"),
        ("--adapter=/no/thing", "--adapter=/no/thing is no checkpoint's folder"),
        ("--env.obs_type=touch", "Slalom has no obs_type 'touch'"),
        ("--env.episode_length=0", "episode_length is 0, but must be at least 1"),
        (
            "--env.obs_type=pixels_agent_pos",
            "the agent needs observation.environment_state (12,), but gloves_slalom has a",
        ),
        ("--methods=[feeg", "the value of an option is not YAML: "),
        ("--num_workers=0", "num_workers is 0"),
    ],
)
def test_wrong_options_are_refused_before_anything_runs(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, wrong: str, message: str
) -> None:
    said = gloves(monkeypatch, "bench", *options, '--methods=["feeg:start=0.5+gate"]', wrong)
    assert message in said
    assert said.startswith("gloves bench: ") and "\n" not in said
    assert not list(tmp_path.rglob("*.json"))


def test_an_adapter_must_be_one(options: list[str], agent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said = gloves(monkeypatch, "bench", *options, f"--adapter={agent}", "--methods=[feeg]")
    assert "is a policy of type 'gloves_flow_policy', which cannot correct another one" in said


def test_a_failed_cell_stops_no_other(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Slalom has no action dimension 7, which only shows while the cell runs."""
    said = gloves(monkeypatch, "bench", *options, '--perturbations=["shift:dim=7", none]')
    assert said == "gloves bench: 1 cell(s) failed, see above; run the command again to try only those"
    assert "shift:dim=7 / agent / seed 0 failed: ValueError: Shift: dim is 7" in capsys.readouterr().err
    assert [row.cell.perturbation for row in read_rows(tmp_path / "rows")] == ["none"]


FILE = """
episodes: 3
num_workers: 1
tasks:
  short:
    env: {{type: gloves_slalom, episode_length: 20}}
    agent: {agent}
    perturbations: {{none: none, noised: "noised:sigma=0.005"}}
    methods:
      agent: {{editor: none}}
      FEEG+gate: {{adapter: {adapter}, editor: "feeg:start=0.5", gate: true}}
  shorter:
    env: {{type: gloves_slalom, episode_length: 12}}
    agent: {agent}
    perturbations: {{noised: "noised:sigma=0.01"}}
    methods:
      FEEG: {{adapter: {adapter}, editor: "feeg:start=0.2", alpha: 0.2}}
"""


@pytest.fixture
def file(tmp_path: Path, agent: str, adapter: str) -> list[str]:
    """Options of a matrix of two tasks."""
    path = tmp_path / "bench.yaml"
    path.write_text(FILE.format(agent=agent, adapter=adapter))
    return [f"--config_path={path}", f"--output_dir={tmp_path / 'rows'}"]


def test_a_file_of_two_tasks(
    tmp_path: Path, file: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert gloves(monkeypatch, "bench", *file) == ""
    printed = capsys.readouterr().out
    rows = read_rows(tmp_path / "rows")
    assert {
        file.stem: row.specification for file, row in zip(sorted((tmp_path / "rows").iterdir()), rows, strict=True)
    } == {
        "short__none__agent__seed0": "none",
        "short__none__FEEG+gate__seed0": "feeg:start=0.5,steps=10,align=1.0+gate",
        "short__noised__agent__seed0": "none",
        "short__noised__FEEG+gate__seed0": "feeg:start=0.5,steps=10,align=1.0+gate",
        "shorter__noised__FEEG__seed0": "feeg:start=0.2,steps=10,align=1.0",
    }
    shorter = next(row for row in rows if row.task == "shorter")
    assert shorter.cell == Cell(
        "noised:sigma=0.01", "feeg:start=0.2", 0, task="shorter", perturbation_label="noised", label="FEEG"
    )
    assert (shorter.conditions["alpha"], shorter.conditions["env"]["episode_length"]) == (0.2, 12)
    assert {episode.steps for episode in shorter.episodes} == {12}
    assert "FEEG+gate" in printed and "FEEG:" in printed


def test_options_select_and_override_what_a_file_says(
    tmp_path: Path, file: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ["--perturbations=[noised]", "--methods=[FEEG]", "--seeds=[2]", "--tasks.shorter.methods.FEEG.alpha=0.3"]
    assert gloves(monkeypatch, "bench", *file, *options) == ""
    (row,) = read_rows(tmp_path / "rows")
    assert (row.cell.task, row.cell.seed, row.conditions["alpha"]) == ("shorter", 2, 0.3)


def test_a_cell_alone_is_the_cell_in_its_matrix(
    tmp_path: Path, file: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was played before it in the same process, and played twice."""
    assert gloves(monkeypatch, "bench", *file) == ""
    together = without_times(read_rows(tmp_path / "rows"))
    for attempt in ("alone", "again"):
        folder = tmp_path / attempt
        only = ["--perturbations=[noised]", "--methods=[FEEG+gate]", f"--output_dir={folder}"]
        assert gloves(monkeypatch, "bench", *file, *only) == ""
        (row,) = without_times(read_rows(folder))
        assert row in together


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--methods=[FEG]"], "no task has a method 'FEG': choose from FEEG, FEEG+gate, agent"),
        (["--perturbations=[noisy]"], "no task has a perturbation 'noisy': choose from noised, none"),
        (["--agent=a"], "agent is for a task without a file: override a file's tasks by options such as --tasks."),
        (["--alpha=0.1"], "alpha is for a task without a file"),
        (["--tasks.short.methods.FEEG+gate.editor=feg"], "unknown method 'feg': choose from feeg, fpas, ifae, none"),
        (["--tasks.short.methods.FEEG+gate.adapter=no/thing"], "--adapter=no/thing is no checkpoint's folder"),
        (
            ["--tasks.short.methods.FEEG+gate.gat=true"],
            "tasks.short.methods.FEEG+gate has no key 'gat': choose from adap",
        ),
        (["--tasks.short.methods.FEEG+gate.options={adapter_map: {}}"], "no adapter option 'adapter_map': choose from"),
        (["--tasks.short.methods.FEEG+gate.gate=7"], "Couldn't parse '7' into a bool"),
        (["--tasks.short.env.obs_type=touch"], "Slalom has no obs_type 'touch'"),
        (["--tasks.short.env.obs_typ=touch"], "The fields `obs_typ` are not valid for SlalomEnv"),
        (["--tasks.short.agent=["], "--agent=[ is no checkpoint's folder"),
        (["--tasks.short.env.episode_length=["], "--tasks.short.env.episode_length=[: the value is not YAML: "),
        (["--executor=spark"], "unknown executor 'spark': choose from local, ray"),
        (["--address=auto"], "address and num_gpus are for --executor=ray"),
        (["--choose=x.yaml"], "choose is for a search, but no method has settings to choose from"),
        (["--config_path=none.yaml"], "there is no file none.yaml"),
    ],
)
def test_wrong_files_and_options_are_refused_in_one_line(
    tmp_path: Path,
    file: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    said = gloves(monkeypatch, "bench", *options, *file)
    errors = capsys.readouterr().err
    assert message in said + errors
    assert "\n" not in (said + errors).strip()
    assert not list(tmp_path.rglob("*.json"))


def test_without_a_task_there_is_nothing_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = gloves(monkeypatch, "bench", f"--output_dir={tmp_path}", "--agent=a")
    assert said == "gloves bench: name the tasks in a file, --config_path=FILE, or one by --env.type and --agent"


def test_ray_is_an_extra(options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    said = gloves(monkeypatch, "bench", *options, "--executor=ray")
    assert said == (
        "gloves bench: --executor=ray needs Ray, which is an extra: pip install 'lerobot_policy_gloves[ray]'"
    )


def test_a_full_disk_ends_the_run_and_keeps_rows(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fsync, written = os.fsync, []

    def full(opened: int) -> None:
        if len(written) == 2:  # the first row's file and its name
            raise OSError(28, "No space left on device")
        written.append(fsync(opened))

    monkeypatch.setattr("os.fsync", full)
    said = gloves(monkeypatch, "bench", *options, "--seeds=[0, 1, 2]")
    assert said.startswith("gloves bench: [Errno 28] No space left on device: '")
    assert said.endswith("seed1.json'; finished cells are kept: run the command again to go on")
    assert [file.name for file in (tmp_path / "rows").iterdir()] == ["gloves_slalom__none__agent__seed0.json"]
    monkeypatch.undo()
    assert gloves(monkeypatch, "bench", *options, "--seeds=[0, 1, 2]") == ""
    assert len(read_rows(tmp_path / "rows")) == 3


def test_search(
    tmp_path: Path, file: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two settings on validation seeds; what is chosen goes into the matrix on test seeds."""
    search, chosen = tmp_path / "search.yaml", tmp_path / "chosen.yaml"
    text = (tmp_path / "bench.yaml").read_text()
    gated = 'editor: "feeg:start=0.5", gate: true'
    settings = 'gate: true, settings: [{editor: "feeg:start=0.5"}, {editor: "feeg:start=0.9", alpha: 0.2}]'
    search.write_text(text.replace(gated, settings))
    options = [f"--config_path={search}", f"--output_dir={tmp_path / 'search'}", f"--choose={chosen}"]
    assert gloves(monkeypatch, "bench", *options) == (
        "gloves bench: a search on the test split: settings are chosen with --split=validation"
    )
    assert gloves(monkeypatch, "bench", *options, "--split=validation", "--methods=[FEEG+gate]") == ""
    printed = capsys.readouterr().out
    assert printed.startswith("short, FEEG+gate: success in % on validation seeds, best first.")
    assert {episode.seed for row in read_rows(tmp_path / "search") for episode in row.episodes} == {
        20000,
        20001,
        20002,
    }
    assert gloves(monkeypatch, "bench", *file, f"--chosen={chosen}", "--methods=[FEEG+gate]") == ""
    rows = read_rows(tmp_path / "rows")
    best = next(line.split("|")[1].strip() for line in printed.splitlines() if line.startswith("| feeg"))
    for row in rows:
        assert (row.cell.editor, row.cell.gate) == (best.partition(",")[0], True)
        assert row.conditions["alpha"] == (0.2 if "alpha 0.2" in best else 0.05)
    assert [row.episodes[0].seed for row in rows] == [10000, 10000]


def test_report_of_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert gloves(monkeypatch, "report", f"--rows={tmp_path}") == "gloves report: there are no rows to report"
    assert "is no folder" in gloves(monkeypatch, "report", f"--rows={tmp_path / 'none'}")
