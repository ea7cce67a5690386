"""What is not trained says so in one line, and what to train instead."""

import pytest
from lerobot.policies import make_policy_config

import lerobot_policy_gloves  # noqa: F401, registers the policies


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("gloves", "gloves wraps a policy .* --policy.type=gloves_expert_flow"),
        ("gloves_person", "a person is not trained"),
    ],
)
def test_there_is_no_optimizer(kind, line):
    config = make_policy_config(kind, device="cpu")
    with pytest.raises(ValueError, match=line):
        config.get_optimizer_preset()
    assert config.get_scheduler_preset() is None
    assert config.action_delta_indices is config.observation_delta_indices is config.reward_delta_indices is None
