"""An editor and a score of another package: entered in the registries they are ours, and no file of ours knows them."""

import dataclasses
import importlib
import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.envs import EnvConfig

from lerobot_gloves.benchmark.setup import Setup, resolve_method
from lerobot_gloves.editors import EDITORS
from lerobot_gloves.generators import spawn
from lerobot_gloves.scores import SCORES, ReverseScore
from tests.builders import calibrate, load, observation, save_policy, wrap

PAGE = Path(__file__).parents[2] / "docs" / "adapters.md"
PACKAGE = "lerobot_policy_nearest"
T = 6
"""Chunk size of the adapter, and of what the agent proposes and executes."""


@pytest.fixture(scope="module")
def checkpoints(checkpoints, tmp_path_factory):
    """With an agent that executes all that it proposes."""
    agent = save_policy(tmp_path_factory.mktemp("whole") / "agent", "act", chunk_size=T, n_action_steps=T)
    return dataclasses.replace(checkpoints, agent=agent)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The page's example, imported as LeRobot imports a plugin; afterwards nobody knows it any more."""
    (code,) = re.findall(rf"`{PACKAGE}/__init__\.py`.*?```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / PACKAGE).mkdir()
    (tmp_path / PACKAGE / "__init__.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module(PACKAGE)
    del EDITORS["nearest"], sys.modules[PACKAGE]


def act(policy, batch) -> torch.Tensor:
    with torch.inference_mode():
        return torch.stack([policy.select_action(batch) for _ in range(T)], dim=1)


def by_hand(folder: Path, batch: dict, proposal: torch.Tensor, samples: int, steps: int) -> torch.Tensor:
    """The nearest of the expert's chunks, drawn one observation and one sample at a time."""
    adapter, (preprocess, postprocess) = load(folder)
    prepared = preprocess({**{key: batch[key] for key in adapter.config.input_features}, "action": proposal})
    nearest = []
    for row, chunk in enumerate(prepared["action"]):
        velocity = adapter.velocity({key: prepared[key][row : row + 1] for key in adapter.config.input_features})
        (generator,) = spawn(0, 1, first_episode=row, stream="editor")
        noise, found = torch.randn(samples, T, 2, generator=generator), []
        for x in noise.split(1):
            for k in range(steps):
                with torch.no_grad():
                    x = x + velocity(x, torch.tensor([k / steps])) / steps
            found.append((float((x[0] - chunk).norm()), x))
        nearest.append(min(found, key=lambda pair: pair[0])[1])
    return postprocess(torch.cat(nearest))


def test_the_pages_editor_corrects_by_an_expert_flow(checkpoints, package):
    batch = observation(3)
    proposal = act(wrap(checkpoints.agent), batch)
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter, method="nearest:samples=8,steps=3")
    edited = act(policy, batch)
    torch.testing.assert_close(edited, by_hand(checkpoints.adapter, batch, proposal, 8, 3), rtol=1e-4, atol=1e-7)
    assert policy.statistics()["evaluations"] == 8 * 3
    gated = wrap(checkpoints.agent, adapter=checkpoints.adapter, method="nearest", gate=True, alpha=0.5)
    assert act(gated, batch).isfinite().all()


def test_the_pages_editor_corrects_by_an_align_flow(checkpoints, package, tmp_path):
    align = save_policy(tmp_path / "align", "gloves_align_flow")
    policy = wrap(checkpoints.agent, adapter=align, method="nearest:samples=2,steps=3")
    assert act(policy, observation(2)).isfinite().all() and policy.statistics()["evaluations"] == 2 * 3


def test_commands_know_it_with_its_options(checkpoints, package, parse_eval):
    wrapped = [f"--policy.path={checkpoints.agent}", "--policy.wrap=gloves", f"--policy.adapter={checkpoints.adapter}"]
    config: EvalPipelineConfig = parse_eval(*wrapped, "--policy.method=nearest:steps=2")
    assert config.policy.method == "nearest:steps=2"
    setup = Setup(
        env=EnvConfig.get_choice_class("gloves_slalom")(),
        agent=str(checkpoints.agent),
        adapter=str(checkpoints.adapter),
    )
    assert resolve_method(setup, "nearest:steps=2", gate=True)["editor"] == "nearest:samples=16,steps=2"
    with pytest.raises(ValueError, match="method 'nearest' has no option 'sample': choose from samples, steps"):
        wrap(checkpoints.agent, adapter=checkpoints.adapter, method="nearest:sample=2")


def test_without_its_package_it_is_no_method(checkpoints):
    with pytest.raises(ValueError, match="unknown method 'nearest': choose from feeg, fpas, ifae, none"):
        wrap(checkpoints.agent, adapter=checkpoints.adapter, method="nearest")


@dataclass(frozen=True)
class Spy:
    """Keeps the proposal and notes what it is given."""

    share: float = 1.0
    given: ClassVar[list] = []

    def __call__(self, proposal, reference):
        self.given.append(reference)
        return proposal


@dataclass(frozen=True)
class Knowing(Spy):
    """Cannot do without the agent's flow."""

    needs_agent: ClassVar[bool] = True


@pytest.fixture
def given(monkeypatch) -> list:
    monkeypatch.setitem(EDITORS, "spy", Spy)
    monkeypatch.setitem(EDITORS, "knowing", Knowing)
    monkeypatch.setattr(Spy, "given", [])
    return Spy.given


def test_an_editor_is_given_what_there_is_and_the_agents_flow_only_if_it_asks(checkpoints, given, tmp_path):
    align, batch = save_policy(tmp_path / "align", "gloves_align_flow"), observation(2)
    act(wrap(checkpoints.agent, adapter=checkpoints.adapter, method="spy", alpha=0.5), batch)
    act(wrap(checkpoints.agent, adapter=align, method="spy"), batch)
    act(wrap(checkpoints.agent, adapter=align, method="knowing"), batch)
    alone, beside, knowing = given
    assert (alone.threshold, beside.threshold) == (50.0, None)  # only the expert flow is calibrated, by 1 to 99
    assert alone.agent is None and beside.agent is None and knowing.agent is not None
    x, t = torch.randn(2, T, 2), torch.full((2,), 0.5)
    assert not torch.allclose(knowing.agent(x, t), knowing.expert(x, t), atol=1e-4)
    for reference in given:
        assert reference.score == SCORES["reverse"]() and reference.length == T
        assert len(reference.generator) == 2
        assert reference.expert(x, t).shape == x.shape


def test_one_that_needs_the_agents_flow_is_refused_without(checkpoints, given):
    with pytest.raises(ValueError, match=r"^knowing needs the agent's flow besides the expert's: take .*agent_flow="):
        wrap(checkpoints.agent, adapter=checkpoints.adapter, method="knowing")


@dataclass(frozen=True)
class Reach:
    """The largest action, whatever the expert."""

    power: float = 1.0

    def __call__(self, velocity, chunk, length=None):
        return chunk[:, :length].abs().amax(dim=(1, 2)) ** self.power


def test_a_score_of_another_package_scores_and_gates(checkpoints, monkeypatch, tmp_path):
    monkeypatch.setitem(SCORES, "reach", Reach)
    table, log = torch.arange(1.0, 100.0).expand(T, -1).clone(), tmp_path / "log"
    folder = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)
    calibrate(folder, scores={"reach:power=2.0": table})
    policy = wrap(checkpoints.agent, adapter=folder, score="reach:power=2", gate=True, alpha=0.5, log=log)
    batch = observation(3)
    proposal = act(wrap(checkpoints.agent), batch)
    act(policy, batch)
    _, (preprocess, _) = load(folder)
    chunk = preprocess({**{key: batch[key] for key in policy._corrector.inputs}, "action": proposal})["action"]
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    expected = chunk.abs().amax(dim=(1, 2)) ** 2
    torch.testing.assert_close(torch.tensor([line["score"] for line in lines]), expected)
    assert wrap(checkpoints.agent, adapter=folder)._corrector.gate.scores == (ReverseScore(),)  # still the default
