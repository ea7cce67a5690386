"""What would go wrong in every cell is found before the first, once and in one line."""

import importlib
import sys
from pathlib import Path

import pytest

from lerobot_gloves.benchmark import play
from tests.benchmark.test_bench import gloves
from tests.builders import save_policy

FILE = """
episodes: 2
num_workers: 1
seeds: [0, 1]
tasks:
  short:
    env: {{type: gloves_slalom, episode_length: 20}}
    agent: {agent}
    perturbations: {{none: none, laggy: "laggy:p=0.2"}}
    methods:
      agent: {{editor: none}}
      ours: {method}
"""


@pytest.fixture
def uncalibrated(tmp_path: Path) -> str:
    return str(save_policy(tmp_path / "uncalibrated", "gloves_expert_flow"))


def said(method: str, agent: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the command ends with; no cell may begin."""
    (tmp_path / "bench.yaml").write_text(FILE.format(agent=agent, method=method))
    monkeypatch.setattr(play, "run", lambda *_: pytest.fail("a cell was played"))
    line = gloves(monkeypatch, "bench", f"--config_path={tmp_path / 'bench.yaml'}", f"--output_dir={tmp_path / 'rows'}")
    assert "\n" not in line and not list(tmp_path.glob("rows/*"))
    return line


@pytest.mark.parametrize(
    ("kind", "method", "message"),
    [
        ("adapter", "editor: ifae", "ifae needs the agent's flow besides the expert's: take a gloves_align_flow"),
        # Whatever the gate would let pass.
        ("adapter", "editor: ifae, gate: true, alpha: 0.005", "ifae needs the agent's flow besides the expert's: take"),
        ("uncalibrated", "editor: fpas", "fpas needs a calibration, and "),
        ("uncalibrated", "editor: feeg, gate: true", "the gate needs a calibration, and "),
        (
            "align_flow",
            'editor: ifae, options: {adapter_overrides: ["--agent_source={perturbation}"]}',
            "agent_source is 'laggy', which the align flow was not trained on: choose from none, noised",
        ),
        (
            "align_flow",
            'editor: ifae, options: {adapter_overrides: ["--agent_source=lagy"]}',
            "with --agent_source=lagy: agent_source is 'lagy': choose from none, noised, laggy, slow, shift",
        ),
        (
            "align_flow",
            'editor: ifae, options: {adapter_overrides: ["--agent_sorce=none"]}',
            "has unrecognized arguments: --agent_sorce=none: choose from --n_obs_steps, ",
        ),
        (
            "adapter",
            "editor: feeg, options: {adapter_rename_map: {observation.environment_state: observation.pillars}}",
            "the adapter needs observation.environment_state, but is given only observation.",
        ),
    ],
)
def test_a_method_that_cannot_work(
    request: pytest.FixtureRequest,
    agent: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    method: str,
    message: str,
) -> None:
    path = request.getfixturevalue(kind)
    line = said(f"{{adapter: {path}, {method}}}", agent, tmp_path, monkeypatch)
    assert line.startswith("gloves bench: short / ours: ")
    assert message in line
    assert "usage" not in capsys.readouterr().err


def test_an_align_flow_that_is_told_a_compound(
    agent: str, align_flow: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = (
        f'{{adapter: {align_flow}, editor: ifae, options: {{adapter_overrides: ["--agent_source={{perturbation}}"]}}}}'
    )
    compound = FILE.replace("laggy: ", "both: ").replace("laggy:p=0.2", "noised:sigma=0.01+laggy:p=0.2")
    monkeypatch.setattr(f"{__name__}.FILE", compound)
    line = said(method, agent, tmp_path, monkeypatch)
    assert "agent_source is 'noised+laggy': choose from none, noised, laggy, slow, shift" in line


@pytest.mark.parametrize("extra", ["slalom", "keypad"])
def test_an_unusable_simulator(extra: str, agent: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it is another version or not there, the line says what to install."""
    monkeypatch.setattr(play, "run", lambda *_: pytest.fail("a cell was played"))
    command = ["bench", f"--env.type=gloves_{extra}", f"--agent={agent}", f"--output_dir={tmp_path}", "--seeds=[0, 1]"]
    mujoco = importlib.import_module("mujoco")
    with monkeypatch.context() as patch:
        patch.setattr(mujoco, "__version__", "3.10.0")
        assert gloves(monkeypatch, *command) == (
            "gloves bench: MuJoCo 3.10.0 is installed, but 3.8.1 <= version < 3.10 is needed: "
            f"pip install 'lerobot_policy_gloves[{extra}]'"
        )
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mujoco", None)
        assert gloves(monkeypatch, *command) == (
            f"gloves bench: MuJoCo is not installed: pip install 'lerobot_policy_gloves[{extra}]'"
        )
    assert not list(tmp_path.iterdir())


def test_a_fault_of_ours_is_left_to_the_cells_which_keep_its_traceback(
    tmp_path: Path, options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("not the user's")

    monkeypatch.setattr("lerobot_gloves.evaluation.agent.WrappedAgent.act", broken)
    assert gloves(monkeypatch, "bench", *options).startswith("gloves bench: 1 cell(s) failed, see above")
    (log,) = (tmp_path / "rows").glob("*.failed")
    assert "RuntimeError: not the user's" in log.read_text() and "in broken" in log.read_text()
