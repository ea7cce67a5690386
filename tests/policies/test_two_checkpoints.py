"""IFAE between an expert flow and an agent flow that are two checkpoints."""

import pytest
import torch

from lerobot_gloves.editors import IFAE, Reference
from tests.builders import load, make_policy, observation, save_policy, statistics, wrap

T = 6


@pytest.fixture(scope="module")
def flows(tmp_path_factory):
    """Folders of an expert flow and an agent flow."""
    folder = tmp_path_factory.mktemp("flows")
    expert = save_policy(folder / "expert", "gloves_expert_flow", seed=1)
    return expert, save_policy(folder / "agent", "gloves_align_flow", seed=2, sources=["none", "slow"])


def test_an_edit_is_ifae_between_the_two(flows):
    expert_folder, agent_folder = flows
    adapter, _ = load(expert_folder, f"--agent_flow={agent_folder}", "--agent_source=slow")
    (expert, _), (agent, _) = load(expert_folder), load(agent_folder, "--agent_source=slow")
    seen, proposal, editor = observation(3), torch.randn(3, T, 2), IFAE(steps=4)
    bound = adapter.bind(seen)
    edited = bound.edit(proposal, editor, generator=torch.Generator().manual_seed(0))
    fields = expert.velocity(seen), agent.agent_velocity(seen)
    expected = editor(proposal, Reference(*fields, generator=torch.Generator().manual_seed(0)))
    torch.testing.assert_close(edited, expected, rtol=0, atol=0)
    assert bound.evaluations == 2 * 4


def test_the_agents_weights_are_not_the_adapters(flows):
    expert_folder, agent_folder = flows
    alone, _ = load(expert_folder)
    beside, _ = load(expert_folder, f"--agent_flow={agent_folder}")
    assert list(beside.state_dict()) == list(alone.state_dict())


def test_the_wrapper_names_it_by_the_adapters_own_option(flows, checkpoints):
    expert, agent = flows
    overrides = [f"--agent_flow={agent}", "--agent_source=slow"]
    policy = wrap(checkpoints.agent, adapter=expert, method="ifae", adapter_overrides=overrides)
    assert policy.select_action(observation(2)).isfinite().all()
    assert policy.correction.edited.all() and (policy.correction.distance > 1e-3).all()


def test_without_one_ifae_says_how_to_name_one(flows, checkpoints):
    message = r"""^ifae needs the agent's flow .*='\["--agent_flow=<checkpoint>"\]'$"""
    with pytest.raises(ValueError, match=message):
        wrap(checkpoints.agent, adapter=flows[0], method="ifae")


def test_a_checkpoint_that_does_not_fit_is_one_clear_line(flows, tmp_path):
    cases = [
        (save_policy(tmp_path / "kind", "gloves_expert_flow"), "type 'gloves_expert_flow', but must be a gloves_align"),
        (save_policy(tmp_path / "size", "gloves_align_flow", chunk_size=4), "chunks of 4 actions, but .* of 6"),
        (save_policy(tmp_path / "cameras", "gloves_align_flow", "pixels_agent_pos"), "train both on the same features"),
        (save_policy(tmp_path / "unseen", "gloves_align_flow", sources=["laggy", "slow"]), "choose from laggy, slow"),
    ]
    for folder, message in cases:
        with pytest.raises(ValueError, match=message) as error:
            load(flows[0], f"--agent_flow={folder}")
        assert "\n" not in str(error.value)


def test_another_normalisation_is_named_and_refused(flows, tmp_path, monkeypatch):
    def other(features):
        stats = statistics(features)
        stats["action"]["std"] *= 1.5
        return stats

    monkeypatch.setattr("tests.builders.statistics", other)
    folder = save_policy(tmp_path / "agent", policy=make_policy("gloves_align_flow"), kind="gloves_align_flow")
    with pytest.raises(ValueError, match=r"normalises action otherwise than the expert flow: train both on one merged"):
        load(flows[0], f"--agent_flow={folder}")
