"""`lerobot-rollout` on a toy robot, and what real-time chunking asks of a policy."""

import signal

import pytest
import torch
from lerobot.policies.rtc import ActionQueue
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.rollout.inference.rtc import _normalize_prev_actions_length, supports_rtc_inference
from lerobot.scripts.lerobot_rollout import rollout

from lerobot_policy_gloves.gloves.realtime import LeftOver
from lerobot_policy_gloves.gloves_flow_policy.modeling_gloves_flow_policy import GlovesFlowPolicy
from tests.builders import load, observation, save_policy, wrap
from tests.policies.toyrobot import INPUTS, OUTPUTS, ToyRobot


@pytest.fixture(scope="module")
def toy_checkpoints(tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    features = {"input_features": INPUTS, "output_features": OUTPUTS}
    agent = save_policy(folder / "agent", "gloves_expert_flow", **features)
    return agent, save_policy(folder / "adapter", "gloves_expert_flow", seed=7, **features)


@pytest.fixture
def operate(typed):
    """Run `lerobot-rollout` with some options; returns the commands that the robot got."""
    names = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    handlers = {name: signal.getsignal(getattr(signal, name)) for name in names}

    def run(*options: str) -> torch.Tensor:
        common = ["--robot.type=gloves_toy", "--fps=500", "--task=move", "--return_to_initial_position=false"]
        typed(*common, *options)
        rollout()
        return torch.tensor(ToyRobot.sent)

    yield run
    for name, handler in handlers.items():
        signal.signal(getattr(signal, name), handler)


def test_the_wrapped_agent_moves_a_robot_as_the_bare_one_does(toy_checkpoints, operate):
    agent, adapter = toy_checkpoints
    bare = operate(f"--policy.path={agent}")
    assert bare.shape == (10, 2) and (bare[1:] != bare[:-1]).any(dim=1).all()
    assert torch.equal(operate(f"--policy.path={agent}", "--policy.wrap=gloves"), bare)
    edited = operate(f"--policy.path={agent}", "--policy.wrap=gloves", f"--policy.adapter={adapter}")
    assert (edited != bare).all()
    named = operate("--policy.type=gloves", f"--policy.agent={agent}", f"--policy.adapter={adapter}")
    assert torch.equal(named, edited)


def test_a_saved_wrapper_moves_a_robot(toy_checkpoints, operate, tmp_path):
    agent, adapter = toy_checkpoints
    wrap(agent, adapter=adapter).save_pretrained(tmp_path / "wrapper")
    edited = operate(f"--policy.path={agent}", "--policy.wrap=gloves", f"--policy.adapter={adapter}")
    assert torch.equal(operate(f"--policy.path={tmp_path / 'wrapper'}"), edited)


def test_real_time_chunking_is_supported_where_the_agent_supports_it(checkpoints, tmp_path, monkeypatch):
    policy = wrap(save_policy(tmp_path / "agent", "gloves_flow_policy"))
    assert not supports_rtc_inference(policy)
    monkeypatch.setattr(GlovesFlowPolicy, "supports_rtc", lambda self: True)
    assert supports_rtc_inference(policy)
    initialised = []
    monkeypatch.setattr(
        GlovesFlowPolicy, "init_rtc_processor", lambda self: initialised.append(self.config.rtc_config), raising=False
    )
    policy.config.rtc_config = RTCConfig(execution_horizon=3)  # as LeRobot does
    policy.init_rtc_processor()
    assert initialised == [policy.config.rtc_config]


def test_what_is_left_of_a_chunk_returns_to_the_agent(checkpoints, tmp_path):
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", chunk_size=9, n_action_steps=2)
    bare, (preprocess, postprocess) = load(agent)
    batch = observation(1)
    proposal = postprocess(bare.predict_action_chunk(preprocess(dict(batch))))
    policy = wrap(agent, adapter=checkpoints.adapter, method="feeg:start=1")  # the identity but for rounding
    asked = []
    predict = policy._agent.policy.predict_action_chunk
    policy._agent.policy.predict_action_chunk = lambda given, **options: asked.append(options) or predict(given)
    chunk = policy.predict_action_chunk(batch, inference_delay=2, prev_chunk_left_over=None)
    assert asked == [{"inference_delay": 2}]
    torch.testing.assert_close(chunk, proposal, rtol=1e-4, atol=1e-8)
    policy.predict_action_chunk(batch, inference_delay=1, prev_chunk_left_over=proposal[0, 4:])
    normalised = preprocess({**batch, "action": proposal})["action"]
    torch.testing.assert_close(asked[1].pop("prev_chunk_left_over"), normalised[0, 4:])
    assert asked[1] == {"inference_delay": 1}


@pytest.mark.parametrize(("executed", "horizon"), [(6, 10), (2, 5), (9, 10), (10, 8)])
def test_the_prefix_of_real_time_chunking_is_what_the_bare_agent_would_get(tmp_path, executed, horizon):
    """LeRobot's own queue and padding, of what each policy returned: normalised actions, or the wrapper's raw ones."""
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", chunk_size=10, n_action_steps=10)
    bare, (preprocess, _) = load(agent)
    policy, batch, asked = wrap(agent), observation(1), []
    predict = policy._agent.policy.predict_action_chunk
    policy._agent.policy.predict_action_chunk = lambda given, **options: asked.append(options) or predict(given)

    def prefix(chunk: torch.Tensor) -> torch.Tensor:
        queue = ActionQueue(RTCConfig(enabled=True, execution_horizon=horizon))
        queue.merge(chunk[0].clone(), chunk[0].clone(), real_delay=0)
        for _ in range(executed):
            queue.get()
        return _normalize_prev_actions_length(queue.get_left_over(), horizon)

    expected = prefix(bare.predict_action_chunk(preprocess(dict(batch))))
    policy.predict_action_chunk(
        batch, inference_delay=1, prev_chunk_left_over=prefix(policy.predict_action_chunk(batch))
    )
    torch.testing.assert_close(asked[1]["prev_chunk_left_over"], expected, rtol=1e-4, atol=1e-6)
    assert policy._step == executed


def test_an_action_that_is_zero_is_no_padding():
    """The robot is told to stop for two steps; of the chunk's six actions four are left, and two zeros fill up."""
    chunk = torch.tensor([[1.0], [2.0], [3.0], [4.0], [0.0], [0.0]])
    told = LeftOver.of(chunk, torch.tensor([[3.0], [4.0], [0.0], [0.0], [0.0], [0.0]]))
    assert (told.actions.flatten().tolist(), told.padding, told.ran) == ([3.0, 4.0, 0.0, 0.0], 2, 2)
    elsewhere = LeftOver.of(chunk, torch.tensor([[9.0], [0.0], [8.0], [0.0]]))
    assert (elsewhere.actions.flatten().tolist(), elsewhere.padding, elsewhere.ran) == ([9.0, 0.0, 8.0], 1, None)
