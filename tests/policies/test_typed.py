"""What is typed means the same in every form, and what it says: checked against what stands between the quotes here."""

import json
import shutil
from pathlib import Path

import draccus
import pytest
from lerobot.configs import parser

from lerobot_gloves.benchmark.matrix_file import complete, nested
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.checkpoints.held_out import load_metadata
from lerobot_gloves.commands.bench import BenchConfig
from lerobot_gloves.commands.calibrate import CalibrateConfig
from lerobot_gloves.commands.record import RecordConfig, RecordedDatasetConfig
from lerobot_gloves.commands.report import ReportConfig
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_policy_gloves.gloves.configuration_gloves import GlovesConfig
from tests.builders import write_dataset

NAMES = ["007", "run #3", "[a]", "1e5", "&c", "{b}", "12e4", "true", "a: b", "2026-01-01", "0x1F", "- x", "'half"]
FORMS = {"wrap": "--policy.path={} --policy.wrap=gloves", "native": "--policy.type=gloves --policy.agent={}"}


def options(form: str, agent: str) -> list[str]:
    return [option.format(agent) for option in FORMS[form].split(" ")]


@pytest.fixture
def home(checkpoints, tmp_path, monkeypatch) -> Path:
    """A home with the agent in it, which is also where one is."""
    shutil.copytree(checkpoints.agent, tmp_path / "agent")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def parsed(typed):
    """What a command's configuration is made of its arguments."""

    def parsed(config_class, *arguments):
        def command(cfg):
            return cfg

        command.__annotations__["cfg"] = config_class
        typed(*arguments)
        return parser.wrap()(command)()

    return parsed


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", NAMES[:5])
def test_a_folder_is_what_it_is_called(home, parse_eval, form, name):
    (home / "agent").rename(home / name)
    config = parse_eval(*options(form, name), "--policy.adapter", name, f"--policy.adapter_revision={name}").policy
    assert (config.agent, config.adapter, config.adapter_revision) == (name, name, name)
    assert config.agent_config.type == "act"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("parser", ["yaml", "json"])
def test_text_is_what_was_typed_to_each_of_the_parsers(name, parser):
    with draccus.config_type(parser):
        config = draccus.parse(GlovesConfig, args=[f"--adapter={name}", f"--log={name}", "--score", "null"])
    assert (config.adapter, config.log, config.score) == (name, Path(name), None)


@pytest.mark.parametrize("form", FORMS)
def test_values_mean_the_same_in_both_forms(home, parse_eval, form):
    config = parse_eval(
        *options(form, "agent"),
        "--policy.adapter='007'",
        "--policy.adapter_rename_map={observation.tip: observation.state}",
        "--policy.adapter_overrides=[--guidance=2]",
        "--policy.alpha=1e-1",
        "--policy.gate=True",
        "--policy.score=null",
        "--policy.perturbation.type=noised",
        "--policy.perturbation.sigma=1e-2",
        "--policy.method=feeg:start=0.4,steps=10",
    ).policy
    assert config.adapter == "007" and config.score is None and config.method == "feeg:start=0.4,steps=10"
    assert config.adapter_rename_map == {"observation.tip": "observation.state"}
    assert config.adapter_overrides == ["--guidance=2"]
    assert (config.alpha, config.gate, config.perturbation.sigma) == (0.1, True, 0.01)


@pytest.mark.parametrize("form", FORMS)
def test_a_tilde_is_a_home(home, parse_eval, form):
    config = parse_eval(*options(form, "~/agent"), "--policy.adapter=~/adapter", "--policy.log=~/log.jsonl").policy
    assert config.agent == str(home / "agent") and config.agent_config.type == "act"
    assert (config.adapter, config.log) == (str(home / "adapter"), home / "log.jsonl")
    assert config.pretrained_path.name == "passthrough"


def test_a_tilde_is_a_home_in_every_command(home, parsed, monkeypatch):
    write_dataset(home / "data", episodes=1)
    typed_root = ["--dataset.repo_id=me/tiny", "--dataset.root=~/data"]
    recording = parsed(RecordConfig, "--env.type=gloves_slalom", "--agent=~/agent", *typed_root)
    assert (recording.root, recording.recorded_agent.checkpoint) == (home / "data", str(home / "agent"))
    calibration = parsed(CalibrateConfig, "--policy.path=~/agent", *typed_root)
    assert (
        calibration.policy.pretrained_path == home / "agent" and load_metadata(calibration.dataset).total_episodes == 1
    )
    matrix = ["--env.type=gloves_slalom", "--agent=~/agent", "--adapter=~/007", "--output_dir=~/rows"]
    bench = parsed(BenchConfig, *matrix, "--choose=~/chosen.yaml")
    assert (bench.output_dir, bench.choose) == (home / "rows", home / "chosen.yaml")
    assert (bench.agent, bench.adapter) == (str(home / "agent"), str(home / "007"))
    assert parsed(ReportConfig, "--rows=~/rows", "--html=~/page.html").rows == home / "rows"
    assert parsed(ReportConfig, "--rows=[~/rows, more]").rows == [home / "rows", Path("more")]
    assert not (home / "~").exists()


def test_a_tilde_is_a_home_in_files_and_from_python(home, parsed):
    recording = RecordConfig(env=SlalomEnv(), dataset=RecordedDatasetConfig("me/x", Path("~/data")), agent="~/agent")
    assert (recording.root, recording.recorded_agent.checkpoint) == (home / "data", str(home / "agent"))
    setup = Setup(env=SlalomEnv(), agent="~/agent", adapter="~/adapter")
    assert (setup.agent, setup.adapter) == (str(home / "agent"), str(home / "adapter"))
    (home / "record.yaml").write_text("env: {type: gloves_slalom}\ndataset: {repo_id: me/x, root: ~/data}\n")
    assert parsed(RecordConfig, "--config_path=~/record.yaml").root == home / "data"
    (home / "bench.yaml").write_text(
        "output_dir: ~/rows\ntasks:\n  short:\n    env: {type: gloves_slalom}\n    agent: ~/agent\n"
        "    perturbations: {none: none}\n    methods: {agent: {editor: none}}\n"
    )
    arguments = complete(["--config_path=~/bench.yaml", "--tasks.short.agent=~/007"], BenchConfig)
    bench = parsed(BenchConfig, *arguments)
    assert bench.output_dir == home / "rows" and bench.tasks["short"].agent == str(home / "007")


@pytest.mark.parametrize("name", NAMES[:3])
def test_the_folders_of_the_commands_are_what_they_are_called(home, parsed, name):
    slalom = ["--env.type=gloves_slalom", f"--agent={name}"]
    recording = parsed(RecordConfig, *slalom, "--dataset.repo_id=me/x", f"--dataset.root={name}")
    assert (recording.agent, recording.root) == (name, Path(name))
    bench = parsed(BenchConfig, *slalom, f"--adapter={name}", f"--output_dir={name}", "--env.mode=0 2 3")
    assert (bench.agent, bench.adapter, bench.output_dir) == (name, name, Path(name)) and bench.env.mode == "0 2 3"
    assert nested(f"--tasks.short.agent={name}") == {"short": {"agent": name}}


def test_an_agents_own_options_are_lerobots_to_read(home, parse_eval):
    config = parse_eval("--policy.path=agent", "--policy.n_action_steps=2", "--policy.optimizer_lr=1e-3").policy
    assert (config.type, config.n_action_steps, config.optimizer_lr) == ("act", 2, 1e-3)
    stored = json.loads((home / "agent" / "config.json").read_text())
    assert parse_eval("--policy.path=agent").policy.n_action_steps == stored["n_action_steps"]
