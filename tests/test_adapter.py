import pytest
import torch

from lerobot_gloves.adapter import Adapter, pad
from lerobot_gloves.scores import SCORES
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


EVALUATIONS = {"reverse": 1, "residual": 2 * 5, "likelihood": 10, "selfnormalised": 8 * 5 + (8 + 1) * 2 * 3}
"""Of the network, by each score with its defaults."""


@pytest.mark.parametrize("name", SCORES)
def test_a_score_is_a_function_of_context_and_chunk(name):
    """Of whatever batch they are part of, and inside LeRobot's inference mode."""
    adapter, batch, chunk = make_policy("gloves_expert_flow"), observation(batch=3), torch.randn(3, 6, 2)
    score = adapter.scores[name]()
    bound = adapter.bind(batch)
    expected = bound.score(chunk, score, length=4)
    assert bound.evaluations == EVALUATIONS[name]
    assert expected.shape == (3,) and expected.isfinite().all() and not expected.requires_grad
    for row in range(3):
        alone = bound.select(torch.arange(3) == row).score(chunk[row : row + 1], score, length=4)
        torch.testing.assert_close(alone, expected[row : row + 1], rtol=1e-4, atol=1e-4)
    # Several chunks of one context are adjacent rows, as FPAS asks for.
    twice = adapter.bind(batch).score(chunk.repeat_interleave(2, dim=0), score, length=4)
    torch.testing.assert_close(twice, expected.repeat_interleave(2), rtol=1e-4, atol=1e-4)
    with torch.inference_mode():
        inside = adapter.bind({key: value.clone() for key, value in batch.items()})
        assert torch.equal(inside.score(chunk.clone(), score, length=4), expected)
    moved = chunk.clone()
    moved[:, 4:] += 1
    assert not torch.equal(bound.score(moved, score, length=4), expected), "the flow sees the padding"
