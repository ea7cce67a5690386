"""Around an agent the wrapper adds nothing to its schedule, its weights and its training."""

import pytest

from tests.builders import load, play, save_policy, slalom


def test_the_agent_keeps_its_own_schedule(tmp_path, checkpoints):
    """It plans anew when its chunk is used up, whatever the adapter's chunk size."""
    agent = save_policy(tmp_path / "agent", "act")  # 5 actions of a chunk of 8; the adapter's chunks have 6
    policy, pipelines = load(agent, "--wrap=gloves", f"--adapter={checkpoints.adapter}")
    steps = []
    planner = policy._agent.policy
    planner.model.register_forward_hook(lambda *_: steps.append(policy._step))
    with slalom(episode_length=23) as env:
        play(env, policy, pipelines)
    assert steps == [0, 5, 10, 15, 20]


def test_neither_agent_nor_adapter_is_among_its_weights(tmp_path, checkpoints):
    policy, _ = load(save_policy(tmp_path / "agent", "act"), "--wrap=gloves", f"--adapter={checkpoints.adapter}")
    assert not policy.state_dict() and not list(policy.parameters()) and len(list(policy.modules())) == 1
    policy.save_pretrained(tmp_path / "wrapper")
    assert sorted(path.name for path in (tmp_path / "wrapper").iterdir()) == [
        "config.json",
        "policy_postprocessor.json",
        "policy_preprocessor.json",
    ]


def test_it_cannot_be_trained(tmp_path):
    policy, _ = load(save_policy(tmp_path / "agent", "act"), "--wrap=gloves")
    for refused in (policy.get_optim_params, policy.config.get_optimizer_preset, lambda: policy.forward({})):
        with pytest.raises(ValueError, match=r"train an adapter, such as --policy\.type=gloves_expert_flow"):
            refused()
