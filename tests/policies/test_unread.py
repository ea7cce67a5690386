"""What the wrapper says that nobody will read is read by nobody."""

import pytest
import torch

from tests.builders import observation, save_policy, wrap
from tests.policies.agents import saved_agent

STEPS = 12


@pytest.mark.parametrize("adapted", [False, True])
@pytest.mark.parametrize(
    "kind", ["act", "act_ensembled", "diffusion", "multi_task_dit", "smolvla", "vqbet", "gloves_expert_flow"]
)
def test_what_is_said_to_be_unread_decides_nothing(tmp_path, kind, adapted):
    images = "pixels_agent_pos"
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", images) if adapted else None
    with saved_agent(tmp_path, kind) as agent:
        method = {"method": "feeg:start=0.5"} if adapted else {}
        played, unread = [], 0
        for lies in (False, True):
            policy = wrap(agent, adapter=adapter, **method)
            torch.manual_seed(0)
            actions, hidden = [], False
            for step in range(STEPS):
                told = observation(obs_type=images, seed=1000 + step if lies and hidden else step)
                actions.append(policy.select_action({**told, "task": ["move left", "go right"]}))
                hidden = policy.unread > 0
                unread += hidden
            played.append(torch.stack(actions))
    assert torch.equal(*played)
    assert (unread > 0) == (kind not in ("act_ensembled", "vqbet"))
