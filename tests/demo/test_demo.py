import hashlib
import re
import sys
from pathlib import Path

import pytest
from safetensors import safe_open

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.commands import demo as command
from lerobot_gloves.commands.demo import DemoConfig, runs
from lerobot_gloves.demo import COPILOT, EXPERT_FLOW, PACKAGED, PERSONS_COPILOT, TRIO, evaluation
from lerobot_gloves.demo.evaluation import CHUNK_LOG
from tests.builders import load, save_policy
from tests.preloaded import server


def files(name: str) -> list[Path]:
    return sorted((PACKAGED / name).iterdir())


@pytest.mark.parametrize("name", [*TRIO, PERSONS_COPILOT])
def test_what_is_packaged_is_small_whole_and_as_its_readme_says(name):
    weights = [file for file in files(name) if file.suffix == ".safetensors"]
    assert sum(file.stat().st_size for file in weights) <= 2_000_000
    pages = "".join((PACKAGED / page).read_text() for page in ("README.md", "copilot_person.md"))
    listed = dict(re.findall(r"^\| `(.+?)` \| \d+ \| `([0-9a-f]{64})` \|$", pages, re.M))
    here = {f"{name}/{file.name}": hashlib.sha256(file.read_bytes()).hexdigest() for file in files(name)}
    assert {path: digest for path, digest in listed.items() if path.startswith(f"{name}/")} == here
    with safe_open(PACKAGED / name / "model.safetensors", framework="pt") as tensors:
        assert not any(key.startswith("network.") for key in tensors.keys())  # noqa: SIM118


@pytest.mark.parametrize("name", [*TRIO, PERSONS_COPILOT])
def test_what_is_packaged_names_no_place_of_a_machine(name):
    for file in files(name):
        assert not re.search(rb"\"[^\"\n]*(/home/|/root/|/tmp/|/work/|/Users/)", file.read_bytes()), file.name


@pytest.mark.parametrize(("name", "score"), [(EXPERT_FLOW, DemoConfig().score), (COPILOT, "reverse:steps=1")])
def test_the_packaged_adapters_are_calibrated_for_the_demo(name, score):
    adapter, _ = load(PACKAGED / name)
    calibration = Calibration.load(PACKAGED / name)
    calibration.check(weights_hash(adapter.state_dict()))
    assert len(calibration.of(score, adapter.config.chunk_size)) >= 19  # alpha = 0.05 can reject


def test_the_rows_of_the_table():
    cfg = DemoConfig(fpas="fpas:iterations=2", feeg="feeg:start=0.2", gated_feeg="feeg:start=0.6", alpha=0.1)
    raw, fpas, feeg, gated, copilot = runs(cfg, Path("flow"), Path("pilot"))
    assert raw.options == () and copilot.options == ["--policy.adapter=pilot"]
    assert "--policy.adapter=flow" in fpas.options and f"--policy.method={cfg.fpas}" in fpas.options
    gate = {"--policy.gate=true", "--policy.alpha=0.1"}
    assert set(gated.options) - set(feeg.options) == {*gate, "--policy.method=feeg:start=0.6"}
    assert "--policy.method=feeg:start=0.2" in feeg.options


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--perturbation=jittery"], "unknown perturbation 'jittery': choose from chatter, deadzone, delayed, dropped"),
        (["--feeg=fpas"], "unknown method 'fpas': choose from feeg"),
        (["--fpas=fpas:beam=3"], "method 'fpas' has no option 'beam': choose from"),
        (["--score=surprise"], "unknown score 'surprise': choose from likelihood, residual, reverse, selfnormalised"),
        (["--episodes=0"], "episodes is 0, but must be at least 1"),
        (["--train=true", "--steps=0"], "steps is 0, but must be at least 1"),
        (["--seed=-1"], "seed is -1, but must not be negative"),
        (["--agent=nowhere"], "--agent: nowhere holds no policy"),
        (
            ["--train=true", "--agent=x"],
            "--train=true makes all three: leave --agent, --expert_flow and --copilot out",
        ),
    ],
)
def test_bad_input_gets_one_line(options, line, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["gloves demo", *options])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert str(ended.value).startswith(f"gloves demo: {line}") and "\n" not in str(ended.value)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_run_is_one_line_and_its_log(monkeypatch, tmp_path, capfd):
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy")
    script = tmp_path / "lerobot-eval"
    script.write_text("#!/bin/sh\necho the simulator is missing\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setattr(evaluation, "console_script", lambda name: str(tmp_path / name))
    monkeypatch.setattr(sys, "argv", ["gloves demo", f"--agent={agent}", f"--expert_flow={agent}"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        command.main()
    log = Path("outputs/demo/evaluations/raw.log")
    assert str(ended.value) == f"gloves demo: raw agent failed with exit status 3; all it printed is in {log}"
    assert log.read_text() == capfd.readouterr().err == "the simulator is missing\n"


def test_without_its_simulator_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr(sys, "argv", ["gloves demo"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert str(ended.value) == "gloves demo: MuJoCo is not installed: pip install 'lerobot_policy_gloves[slalom]'"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_from_nothing_to_the_table(tmp_path, monkeypatch, capfd):
    """Everything that `make demo TRAIN=1` does, in the smallest numbers."""
    monkeypatch.setattr(sys, "executable", str(server() / "python"))  # beside which the commands lie that it starts
    options = ["--train=true", "--demonstrations=26", "--steps=2", "--episodes=2", f"--output_dir={tmp_path / 'out'}"]
    options += ["--fpas=fpas:iterations=2,candidates=4", "--score=reverse:steps=1"]
    monkeypatch.setattr(sys, "argv", ["gloves demo", *options])
    command.main()
    rows = [line for line in capfd.readouterr().out.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows[2:]] == ["raw agent", "FPAS", "FEEG", "FEEG + gate", "copilot"]
    assert "\n".join(rows) in (tmp_path / "out" / "table.md").read_text()
    assert (tmp_path / "out" / "paths.png").exists()
    for name in ("fpas", "feeg", "feeg_gate", "copilot"):
        assert (tmp_path / "out" / "evaluations" / name / CHUNK_LOG).exists()
    for name in TRIO:
        for file in (tmp_path / "out" / name).iterdir():
            assert str(tmp_path).encode() not in file.read_bytes(), file
