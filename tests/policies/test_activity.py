"""The line that says what is active, and the one that says what was done."""

import json
import logging
import re

import numpy as np
import pytest
import torch
from lerobot.configs.train import TRAIN_CONFIG_NAME
from lerobot.policies import make_policy

from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.perturbations import Noised
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_policy_gloves.gloves.journal import Journal
from lerobot_policy_gloves.gloves.latency import Latencies
from tests.builders import calibrate, observation, save_policy, wrap


@pytest.fixture
def trained(tmp_path):
    """An adapter that says what it was trained on, calibrated on 99 chunks of two episodes."""
    adapter = calibrate(save_policy(tmp_path / "adapter", "gloves_expert_flow"), episode_of=(7,) * 50 + (8,) * 49)
    (adapter / TRAIN_CONFIG_NAME).write_text(
        json.dumps({"dataset": {"repo_id": "me/trained"}, "env": {"type": "gone"}})
    )
    return adapter


def started(caplog, *arguments, **options) -> str:
    caplog.clear()
    with caplog.at_level(logging.INFO):
        wrap(*arguments, **options)
    [told] = [record.getMessage() for record in caplog.records if record.getMessage().startswith("gloves: agent")]
    assert "\n" not in told
    return told


def test_the_start_line_says_what_is_active(checkpoints, trained, caplog):
    told = started(caplog, checkpoints.agent, adapter=trained, gate=True, alpha=0.1, method="feeg:start=0.3")
    assert told == (
        f"gloves: agent {checkpoints.agent}, adapter {trained} (gloves_expert_flow, trained on me/trained), method "
        "feeg:start=0.3,steps=10,align=1.0, gate at alpha 0.1 of chunks by reverse:steps=1, calibrated on me/expert: "
        "99 chunks of 2 episodes"
    )
    told = started(caplog, checkpoints.agent, adapter=trained, gate=True, alpha=0.5, alpha_of="episodes")
    assert "gate at alpha 0.5 of episodes by" in told


def test_the_start_line_without_gate_calibration_or_training(checkpoints, tmp_path, caplog):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow")
    told = started(caplog, checkpoints.agent, adapter=adapter, perturbation=Noised(sigma=0.01))
    assert "trained on unknown data" in told and "perturbed by noised:sigma=0.01" in told
    assert told.endswith("no gate: every chunk is edited, not calibrated")
    assert started(caplog, checkpoints.agent, adapter=adapter, method="none").endswith(
        "method none, no gate, not calibrated"
    )


def test_a_benchmark_is_told_nothing_of_its_cells(checkpoints, caplog):
    """Neither when a cell's agent is loaded nor when it is done with."""
    with caplog.at_level(logging.INFO):
        agent = load_agent(SlalomEnv(), str(checkpoints.agent), "none", 0, adapter=str(checkpoints.adapter))
        agent.policy.select_action(observation(2))
        assert agent.policy.statistics()["chunks"] == 2
        del agent
    assert "gloves:" not in caplog.text


def test_the_end_line_comes_when_a_wrapper_is_done_with(checkpoints, caplog):
    with caplog.at_level(logging.INFO):
        policy = wrap(checkpoints.agent, adapter=checkpoints.adapter)
        with torch.inference_mode():
            policy.select_action(observation(2))
        distance = policy.statistics()["distance"]
        policy._journal.report()
    assert re.search(
        rf"gloves: 2 chunks, 100\.0 % edited, mean distance {distance:.3f} \(normalised\), "
        r"[\d.]+ evaluations a chunk, latency p50 [\d.]+ ms, p99 [\d.]+ ms$",
        caplog.messages[-1],
    )


def test_latency_is_told_against_the_control_period(parse_eval, checkpoints, caplog):
    config = parse_eval(f"--policy.path={checkpoints.agent}", "--policy.wrap=gloves", "--policy.adapter=null")
    assert config.policy.control_period == 1000 / config.env.fps == 50
    config.policy.adapter = str(checkpoints.adapter)
    with caplog.at_level(logging.INFO):
        policy = make_policy(config.policy, env_cfg=config.env)
        policy.select_action(observation(2))
        policy._journal.report()
    assert caplog.messages[-1].endswith(" ms of a control period of 50.0 ms")


def test_quantiles_of_latencies_are_those_of_all_of_them():
    drawn = np.random.default_rng(0).lognormal(2.5, 1.0, size=20_000)
    latencies = Latencies()
    for one in drawn:
        latencies.note(one)
    for share in (0.5, 0.99, 1.0):
        assert latencies.quantile(share) == pytest.approx(np.quantile(drawn, share), rel=0.01)
    assert len(latencies._counts) < 1000
    assert Latencies().quantile(0.5) == 0
    latencies.note(0.0)
    latencies.note(float("inf"))


def test_the_latency_is_what_the_batch_waited_for(checkpoints, monkeypatch):
    noted = []
    monkeypatch.setattr(Latencies, "note", lambda self, milliseconds: noted.append(milliseconds))
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter)
    assert isinstance(policy._journal, Journal)
    policy.running = torch.tensor([True, False, True, True])
    policy.select_action(observation(4))
    assert noted == [pytest.approx(3 * policy.correction.milliseconds)]
