import torch

from lerobot_gloves.adapter import Adapter, pad
from tests.builders import make_policy, observation


def test_padding_repeats_the_last_action():
    chunk = torch.tensor([[[1.0, 2.0], [3.0, 4.0]], [[5.0, 6.0], [7.0, 8.0]]])
    padded = pad(chunk, 4)
    assert padded.tolist()[0] == [[1, 2], [3, 4], [3, 4], [3, 4]]
    assert padded.tolist()[1] == [[5, 6], [7, 8], [7, 8], [7, 8]]
    assert torch.equal(pad(chunk, 2), chunk)


def test_an_expert_flow_is_an_adapter_and_an_agent_is_none():
    assert isinstance(make_policy("gloves_expert_flow"), Adapter)
    assert not isinstance(make_policy("gloves_flow_policy"), Adapter)
    assert not isinstance(make_policy("act"), Adapter)


def test_a_bound_adapter_counts_evaluations_per_chunk():
    adapter = make_policy("gloves_expert_flow")
    bound = adapter.bind(observation(batch=3))
    chunk = torch.randn(3, 6, 2)
    bound.score(chunk, adapter.scores["reverse"](steps=4))
    assert bound.evaluations == 4
    some = bound.select(torch.tensor([True, False, True]))
    some.edit(chunk[::2], adapter.editors["feeg"](steps=3))
    assert (some.evaluations, bound.evaluations) == (3, 4)
    editor, score = adapter.editors["fpas"](iterations=2, candidates=5), adapter.scores["reverse"](steps=1)
    some.edit(chunk[::2], editor, score=score, threshold=1.0)
    assert some.evaluations == 3 + 2 * 5


def test_what_is_bound_inside_inference_mode_can_be_differentiated():
    adapter, batch, chunk = make_policy("gloves_expert_flow"), observation(batch=2), torch.randn(2, 6, 2)
    editor = adapter.editors["feeg"](start=0.2, steps=3)

    def edit():
        generator = torch.Generator().manual_seed(0)
        return adapter.bind(batch).edit(chunk, editor, generator=generator)

    expected = edit()
    with torch.inference_mode():
        batch = {key: value.clone() for key, value in batch.items()}
        assert torch.equal(edit(), expected)
