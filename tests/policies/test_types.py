"""Whatever type an agent's actions have, and on a device that knows no double precision, as Apple's."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from gloves_flow.inputs import FlowInputs
from lerobot_gloves.recording.sources import agent_task
from tests.builders import FLOW, calibrate, make_policy, observation, save_policy, wrap

T = FLOW["chunk_size"]
ADAPTERS = ["gloves_expert_flow", "gloves_copilot", "gloves_align_flow"]


class NoDouble(TorchDispatchMode):
    """Refuses what such a device refuses."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        for one in tree_leaves(result):
            if isinstance(one, torch.Tensor) and one.dtype == torch.float64:
                raise TypeError(f"Cannot convert a MPS Tensor to float64 dtype: {function}")
        return result


def test_such_a_device_refuses():
    with pytest.raises(TypeError, match="float64"), NoDouble():
        torch.ones(2).double()


@pytest.mark.parametrize("kind", ["gloves_flow_policy", *ADAPTERS])
def test_training_and_inference_need_no_double_precision(kind):
    policy = make_policy(kind)
    policy.config.fps = 20
    actions = {"gloves_align_flow": 2 * T - 1, "gloves_copilot": 2 * policy.config.n_action_steps + T}.get(kind, T)
    batch = {
        **observation(4),
        "action": torch.randn(4, actions, 2),
        "action_is_pad": torch.zeros(4, actions, dtype=torch.bool),
        "timestamp": torch.arange(4) / 20,
        "task": 2 * [agent_task("noised", T)] + 2 * ["0 2 3"],
    }
    with NoDouble():
        loss, _ = policy.train()(batch)
        loss.backward()
        policy.eval().predict_action_chunk(observation(4))
        if hasattr(policy, "bind"):
            bound, chunk = policy.bind(observation(2)), torch.randn(2, T, 2)
            score = policy.scores["reverse"]()
            bound.score(chunk, score)
            for name in ("feeg", policy.default_editor):
                editor = policy.editors[name]()
                bound.edit(chunk, editor, score=score, threshold=1.0, length=T, generator=torch.Generator())


def test_the_row_of_a_proposal_is_exact_in_single_precision():
    """An agent's longest episode: each row is told from its timestamp to which action of its block it belongs."""
    policy = make_policy("gloves_align_flow")
    for fps in (7, 20, 30, 50, 60):
        policy.config.fps, rows = fps, torch.tensor([0, 1, 5, 6, 1_001, 65_537, 999_999, 3_999_998])
        batch = {
            "action": torch.arange(2 * T - 1.0)[None, :, None].expand(len(rows), -1, 2),
            "action_is_pad": torch.zeros(len(rows), 2 * T - 1, dtype=torch.bool),
            "timestamp": (rows.double() / fps).float(),
            "task": len(rows) * [agent_task("noised", T)],
        }
        begin = T - 1 - rows % T
        assert policy._chunks(batch)["action"][:, 0, 0].tolist() == begin.tolist()


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.float16])
@pytest.mark.parametrize("kind", ADAPTERS)
def test_an_agents_actions_may_be_of_any_type(checkpoints, tmp_path, kind, dtype):
    """They are corrected as the same numbers of single precision are."""
    adapter = calibrate(save_policy(tmp_path / "adapter", kind))
    policy = wrap(checkpoints.agent, adapter=adapter, log=tmp_path / "log")
    proposal, seen = (0.01 * torch.randn(2, T, 2)).to(dtype), observation(2)

    def correct(proposal):
        generators = [torch.Generator().manual_seed(row) for row in range(2)]
        return policy._corrector(seen, proposal, generators)

    given, expected = correct(proposal), correct(proposal.float())
    assert given.action.dtype == dtype and given.edited.all()
    torch.testing.assert_close(given.action, expected.action.to(dtype))


def test_an_adapter_that_makes_no_type_its_own_corrects_actions_of_double_precision(checkpoints, tmp_path, monkeypatch):
    """One that was saved before its flow had a step for its inputs: the edit comes back in what the agent's have."""
    adapter = calibrate(save_policy(tmp_path / "adapter", "gloves_expert_flow"))
    policy = wrap(checkpoints.agent, adapter=adapter)
    loaded = policy._corrector.loaded
    older = [step for step in loaded.preprocess.steps if not isinstance(step, FlowInputs)]
    assert len(older) == len(loaded.preprocess.steps) - 1
    monkeypatch.setattr(loaded.preprocess, "steps", older)
    proposal, generators = (
        0.01 * torch.randn(2, T, 2).double(),
        [torch.Generator().manual_seed(row) for row in range(2)],
    )
    given = policy._corrector(observation(2), proposal, generators)
    assert given.action.dtype == torch.float64 and given.distance.dtype == torch.float32 and given.edited.all()
