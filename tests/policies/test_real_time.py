"""`lerobot-rollout` with real-time chunking, from end to end: SmolVLA's architecture, wrapped, moves the toy robot."""

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy

from lerobot_policy_gloves.gloves.modeling_gloves import GlovesPolicy
from tests.builders import CAMERA, save_policy, statistics
from tests.policies.agents import saved_agent
from tests.policies.smolvla import SIZE
from tests.policies.test_robots import operate  # noqa: F401, a fixture
from tests.policies.toyrobot import INPUTS, OUTPUTS, ToyRobot

pytest.importorskip("transformers")
COVERED, HORIZON = 6, 5
"""Actions that the adapter corrects of a chunk of ten, and the length of the prefix that LeRobot gives back."""


@pytest.fixture
def seeing(monkeypatch):
    """The toy robot with a camera."""
    look, features = ToyRobot.get_observation, ToyRobot.observation_features
    frame = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3), dtype=np.uint8)
    monkeypatch.setattr(ToyRobot, "observation_features", {**features, "front": (SIZE, SIZE, 3)})
    monkeypatch.setattr(ToyRobot, "get_observation", lambda self: {**look(self), "front": frame})


@pytest.mark.slow
def test_a_wrapped_vla_moves_a_robot_in_real_time(seeing, operate, monkeypatch, tmp_path, capsys):  # noqa: F811
    inputs = {**INPUTS, CAMERA: PolicyFeature(FeatureType.VISUAL, (3, SIZE, SIZE))}
    seen = {"input_features": inputs, "output_features": OUTPUTS}
    with saved_agent(tmp_path, "smolvla", chunk_size=10, n_action_steps=10, **seen) as agent:
        adapter = save_policy(
            tmp_path / "adapter", "gloves_expert_flow", seed=7, input_features=INPUTS, output_features=OUTPUTS
        )
        asked, proposed, given, returned = [], [], [], []
        inner, outer = SmolVLAPolicy.predict_action_chunk, GlovesPolicy.predict_action_chunk

        def propose(self, batch, **options):
            asked.append(options.get("prev_chunk_left_over"))
            proposed.append(inner(self, batch, **options))
            return proposed[-1]

        def correct(self, batch, **options):
            given.append(options.get("prev_chunk_left_over"))
            returned.append(outer(self, batch, **options))
            return returned[-1]

        monkeypatch.setattr(SmolVLAPolicy, "predict_action_chunk", propose)
        monkeypatch.setattr(GlovesPolicy, "predict_action_chunk", correct)
        sent = operate(
            f"--policy.path={agent}",
            "--policy.wrap=gloves",
            f"--policy.adapter={adapter}",
            "--fps=5",
            "--robot.steps=15",
            "--inference.type=rtc",
            f"--inference.rtc.execution_horizon={HORIZON}",
            "--inference.queue_threshold=4",
        )
    count = min(len(proposed), len(returned))
    assert count >= 3 and len(sent) == 15
    stats = statistics({**inputs, **OUTPUTS})["action"]
    mean, std = torch.tensor(stats["mean"]), torch.tensor(stats["std"])
    for step in range(count):
        decoded = proposed[step] * std + mean
        torch.testing.assert_close(returned[step][:, COVERED:], decoded[:, COVERED:])
        same = torch.isclose(returned[step][:, :COVERED], decoded[:, :COVERED])
        assert not same.all(dim=-1).any(), "what is covered is edited"
    assert given[0] is None and asked[0] is None
    assert any(raw.any() for raw in given[1:count]), "on a slow machine nothing may be left now and then"
    for raw, normalised in zip(given[1:count], asked[1:count], strict=True):
        left = raw.any(dim=1)
        assert len(raw) == HORIZON
        torch.testing.assert_close(normalised[left], (raw[left] - mean) / std)
        assert not normalised[~left].any(), "padding is padding to the agent as well"
    chunks = torch.cat(returned).flatten(0, 1)
    distance = (sent[:, None] - chunks[None]).abs().amax(dim=-1).amin(dim=1)
    assert (distance < 1e-6).all(), "the robot is sent what the wrapper returned"
    assert f"gloves: agent {agent}, adapter {adapter} (gloves_expert_flow, " in capsys.readouterr().err
