"""The likelihood score against densities in closed form.

On a Gaussian flow the Jacobian is diagonal with g, so the exact divergence is the sum of g(t), every probe finds it
exactly, and what is left is the error of the Euler steps, of first order in their size.
"""

import math

import pytest
import torch

from lerobot_gloves.scores import LikelihoodScore, ReverseScore
from tests.gaussian import GaussianFlow, example_flow, seeded, two_modes


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def chunks(flow) -> torch.Tensor:
    return flow.sample(7, seeded(0))


def exact(flow: GaussianFlow, chunks: torch.Tensor) -> torch.Tensor:
    """-log p of every number."""
    return -torch.distributions.Normal(flow.mean, flow.std).log_prob(chunks)


def coupled(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
    """A field whose Jacobian has entries off its diagonal; its trace is 2 sum of x + 6 sin(t), see the test."""
    return x**2 + x.flip(1) * 0.5 + t.sin()[:, None, None] * x + x.sum((1, 2), keepdim=True) * 0.25


@pytest.mark.parametrize("probes", [0, 1])
def test_with_many_steps_it_is_the_density(flow, chunks, probes):
    expected = exact(flow, chunks).sum((1, 2))
    fine, coarse = (LikelihoodScore(steps=n, probes=probes)(flow, chunks) - expected for n in (800, 400))
    assert fine.abs().max() < 0.08
    assert coarse.norm() / fine.norm() == pytest.approx(2, rel=0.02), "an error of first order"


def test_of_two_modes_it_is_the_density():
    flow = two_modes(std=0.3)
    chunks = torch.cat([flow.sample(6, seeded(1)), 0.3 * torch.ones(1, 3, 2, dtype=torch.float64)])
    expected = -flow.log_density(chunks)
    score = LikelihoodScore(steps=800, probes=0)(flow, chunks)
    assert (score - expected).abs().max() < 0.1
    assert expected.max() - expected.min() > 5


def test_few_steps_by_hand(flow, chunks):
    times = torch.tensor([1.0, 0.75, 0.5, 0.25], dtype=torch.float64)
    divergence = flow.gain(times, chunks[:1].expand(4, -1, -1)).sum((1, 2)).mean()
    norm = ReverseScore(steps=4)(flow, chunks)
    expected = 0.5 * norm + 3 * math.log(2 * math.pi) + divergence
    assert torch.allclose(LikelihoodScore(steps=4)(flow, chunks), expected, rtol=1e-12)


def test_the_exact_divergence_is_the_trace():
    """Of x^2 2 x, of the flip 0.5 for the middle action alone, of sin(t) itself and of the sum 0.25, at each number."""
    x = torch.randn(5, 3, 2, generator=seeded(3), dtype=torch.float64)
    trace = 2 * x.sum((1, 2)) + 2 * 0.5 + 6 * math.sin(1.0) + 6 * 0.25
    norm = 0.5 * ReverseScore(steps=1)(coupled, x) + 3 * math.log(2 * math.pi)
    assert torch.allclose(LikelihoodScore(steps=1, probes=0)(coupled, x) - norm, trace)


def test_probes_estimate_the_trace_and_are_the_same_for_every_chunk():
    x = torch.randn(5, 3, 2, generator=seeded(3), dtype=torch.float64)
    exactly = LikelihoodScore(steps=1, probes=0)(coupled, x)
    error = LikelihoodScore(steps=1, probes=1)(coupled, x) - exactly
    # What is off the diagonal does not depend on x here, so a probe errs by the same for all chunks.
    assert error.abs().max() > 0.1
    assert torch.allclose(error, error[:1].expand(5))
    assert (LikelihoodScore(steps=1, probes=2000)(coupled, x) - exactly).abs().max() < 0.1
    assert not torch.allclose(LikelihoodScore(steps=1, seed=1)(coupled, x), exactly + error)


def test_padding_is_seen_by_the_flow_but_left_out_of_norm_and_divergence(flow, chunks):
    for probes in (0, 1):
        score = LikelihoodScore(steps=800, probes=probes)
        assert (score(flow, chunks, length=2) - exact(flow, chunks)[:, :2].sum((1, 2))).abs().max() < 0.08
    score = LikelihoodScore(steps=3)
    assert torch.equal(score(flow, chunks, length=3), score(flow, chunks))
    moved = chunks.clone()
    moved[:, 2] += 1
    assert (score(coupled, moved, length=2) != score(coupled, chunks, length=2)).all()


def test_the_score_is_per_context():
    flows = example_flow(contexts=4)
    chunks = torch.randn(4, 3, 2, generator=seeded(2), dtype=torch.float64)
    alone = [LikelihoodScore()(GaussianFlow(flows.mean[i], flows.std[i]), chunks[i : i + 1]) for i in range(4)]
    assert torch.allclose(LikelihoodScore()(flows, chunks), torch.cat(alone), rtol=1e-12)


def test_the_score_rises_with_the_distance_and_is_negative_where_the_density_is_above_one():
    flow = GaussianFlow(torch.zeros(3, 2, dtype=torch.float64), torch.full((3, 2), 0.1, dtype=torch.float64))
    away = torch.linspace(0, 5, 11, dtype=torch.float64)[:, None, None] * flow.std
    scores = LikelihoodScore(steps=50)(flow, away)
    assert (scores.diff() > 0).all()
    assert scores[0] < 0 < scores[-1]


def test_inference_mode_and_no_grad_change_nothing_and_nothing_is_left_to_differentiate(flow, chunks):
    expected = LikelihoodScore()(flow, chunks)
    assert not expected.requires_grad
    for mode in (torch.inference_mode, torch.no_grad):
        with mode():
            assert torch.equal(LikelihoodScore()(flow, chunks.clone()), expected)


def test_a_field_that_does_not_depend_on_the_chunk_has_no_divergence(chunks):
    for field in (lambda x, t: torch.zeros_like(x), lambda x, t: torch.zeros_like(x).requires_grad_()):
        expected = 0.5 * chunks.square().sum((1, 2)) + 3 * math.log(2 * math.pi)
        assert torch.allclose(LikelihoodScore()(field, chunks), expected)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"steps": 0}, "steps is 0, but must be at least 1"), ({"probes": -1}, "probes is -1, but must not be negative")],
)
def test_settings_that_mean_nothing_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        LikelihoodScore(**options)


def test_a_chunk_that_is_not_a_number_has_a_score_that_is_not_one(flow, chunks):
    chunks[3, 0, 0] = math.nan
    assert LikelihoodScore()(flow, chunks).isnan().tolist() == [i == 3 for i in range(7)]
