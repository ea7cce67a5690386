"""What is executed after an edit lies where the environment, or the expert's data, says; what is not edited stays."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from lerobot_gloves.editors import FEEG, Reference
from lerobot_gloves.evaluation.agent import WrappedAgent
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.generators import spawn
from tests.builders import load, observation, save_policy, wrap

LOW, HIGH = torch.tensor([-0.002, -0.001]), torch.tensor([0.001, 0.003])
"""The range of the data of a narrow expert."""


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """An adapter whose expert never left the range."""
    folder = save_policy(tmp_path_factory.mktemp("narrow") / "adapter", "gloves_expert_flow", seed=7)
    for path in folder.glob("*normalizer_processor.safetensors"):
        save_file({**load_file(path), "action.min": LOW, "action.max": HIGH}, path)
    return folder


def act(policy, batch, steps: int = 5) -> torch.Tensor:
    with torch.inference_mode():
        return torch.stack([policy.select_action(batch) for _ in range(steps)], dim=1)


def inside(actions: torch.Tensor, low: torch.Tensor = LOW, high: torch.Tensor = HIGH) -> torch.Tensor:
    return ((actions >= low) & (actions <= high)).all(dim=-1)


def test_an_edit_stays_inside_the_range_of_the_experts_data(checkpoints, narrow):
    batch, policy = observation(4), wrap(checkpoints.agent, adapter=narrow, method="feeg:steps=2")
    with torch.inference_mode():
        policy.select_action(batch)
    proposal, executed = policy._plan.actions[:, :6], policy.correction.action
    adapter, (preprocess, postprocess) = load(narrow)
    inputs = {key: value for key, value in batch.items() if key in adapter.config.input_features}
    prepared = preprocess({**inputs, "action": proposal})["action"]
    bound = adapter.velocity(preprocess({**inputs, "action": proposal}))
    edited = postprocess(FEEG(steps=2)(prepared, Reference(bound, generator=spawn(0, 4, stream="editor"))))
    assert not inside(edited).all() and inside(edited).any()
    expected = np.clip(edited.numpy(), LOW.numpy(), HIGH.numpy())
    np.testing.assert_allclose(executed.numpy(), expected, rtol=1e-4, atol=1e-7)
    assert inside(executed).all()
    moved = (preprocess({**inputs, "action": executed})["action"] - prepared).norm(dim=-1).mean(dim=-1)
    torch.testing.assert_close(policy.correction.distance, moved, rtol=1e-3, atol=1e-5)


def test_what_is_not_edited_may_leave_it(checkpoints, narrow):
    batch = observation(4)
    raw = act(wrap(checkpoints.agent), batch)
    assert not inside(raw).all()
    assert torch.equal(act(wrap(checkpoints.agent, adapter=narrow, method="none"), batch), raw)


class Strict(gym.Env):
    """An environment that insists on its bounds."""

    metadata = {"render_modes": [], "render_fps": 20}
    observation_space = gym.spaces.Dict(
        {
            "agent_pos": gym.spaces.Box(-np.inf, np.inf, (4,), np.float32),
            "environment_state": gym.spaces.Box(-np.inf, np.inf, (12,), np.float32),
        }
    )
    action_space = gym.spaces.Box(np.float32([-0.01, -0.003]), np.float32([0.001, 0.01]), dtype=np.float32)
    _max_episode_steps, task_description = 12, "stay inside"

    def __init__(self, taken: list[np.ndarray]):
        self.taken = taken

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        assert self.action_space.contains(action), f"{action} is outside"
        self.taken.append(action.copy())
        return self.observation_space.sample(), 0.0, False, False, {}


def test_an_environment_that_insists_on_its_bounds_goes_on(checkpoints, narrow):
    """Told of its action space, the wrapper uses all of it, also beyond the range of the expert's data."""
    policy, taken = wrap(checkpoints.agent, adapter=narrow, method="feeg:steps=2"), []
    env = gym.vector.SyncVectorEnv([partial(Strict, taken)] * 2)
    agent = WrappedAgent(policy, lambda seen: seen, lambda action: action)
    assert len(rollout(env, agent, seeds=[0, 1])) == 2
    env.close()
    assert policy.statistics()["intervention_rate"] == 1
    assert not inside(torch.tensor(np.stack(taken))).all()
