"""The reverse score on a Gaussian flow, where Euler's steps can be multiplied out.

With d = x_t - t mu, a backward step of 1 / N from t = j / N multiplies d by 1 - g / N, and with g as written
down in `gaussian.py` that factor is

    f_j = ((N - j)(N - j + 1) + j (j - 1) s^2) / ((N - j)^2 + j^2 s^2).

So z_hat = f_N ... f_1 (x - mu), and the score is the sum of its squares.
"""

import math

import pytest
import torch
from scipy import stats

from lerobot_gloves.scores import ReverseScore
from tests.gaussian import GaussianFlow, example_flow, seeded


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def chunks() -> torch.Tensor:
    return 2 * torch.randn(7, 3, 2, generator=seeded(0), dtype=torch.float64)


def factor(steps: int, std: torch.Tensor) -> torch.Tensor:
    product = torch.ones_like(std)
    for j in range(1, steps + 1):
        k = steps - j
        product = product * (k * (k + 1) + j * (j - 1) * std**2) / (k**2 + j**2 * std**2)
    return product


@pytest.mark.parametrize("steps", [1, 2, 3, 5, 10, 50])
def test_the_score_is_the_euler_product(flow, chunks, steps):
    expected = (factor(steps, flow.std) * (chunks - flow.mean)).square().sum((1, 2))
    score = ReverseScore(steps=steps)(flow, chunks)
    assert score.shape == (7,)
    assert torch.allclose(score, expected, rtol=1e-10, atol=1e-20)


def test_one_step_is_the_default_and_is_zero_on_a_flow_without_error(flow, chunks):
    assert ReverseScore() == ReverseScore(steps=1)
    assert ReverseScore()(flow, chunks).max() < 1e-25


def test_one_step_is_what_the_paper_writes(chunks):
    """z_hat = x - v(x, 1), on a field that is not a flow of anything."""
    seen = []

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        seen.append(t)
        return torch.sin(x)

    expected = (chunks - torch.sin(chunks)).pow(2).sum((1, 2))
    assert torch.allclose(ReverseScore()(field, chunks), expected)
    assert len(seen) == 1
    assert torch.equal(seen[0], torch.ones(7, dtype=torch.float64))


def test_two_and_three_steps_by_hand(flow, chunks):
    variance, centred = flow.std**2, chunks - flow.mean
    two = centred / (1 + variance)
    three = 8 * (1 + variance) / ((1 + 4 * variance) * (4 + variance)) * centred
    assert torch.allclose(ReverseScore(steps=2)(flow, chunks), two.square().sum((1, 2)), rtol=1e-10)
    assert torch.allclose(ReverseScore(steps=3)(flow, chunks), three.square().sum((1, 2)), rtol=1e-10)


@pytest.mark.parametrize("steps", [2, 5, 10])
def test_on_a_narrow_expert_the_score_grows_as_steps_minus_one(steps):
    flow = GaussianFlow(torch.zeros(3, 2, dtype=torch.float64), torch.full((3, 2), 1e-8, dtype=torch.float64))
    score = ReverseScore(steps=steps)(flow, torch.full((1, 3, 2), 0.1, dtype=torch.float64))
    assert score.item() == pytest.approx(6 * (0.1 * (steps - 1)) ** 2, rel=1e-9)


def test_many_steps_give_the_chi_squared_distance(flow):
    """The exact inverse is z = (x - mu) / s: expert chunks score chi-squared, 3 x 2 degrees of freedom."""
    chunks = flow.sample(3000, seeded(1))
    scores = ReverseScore(steps=400)(flow, chunks)
    exact = ((chunks - flow.mean) / flow.std).square().sum((1, 2))
    assert torch.allclose(scores, exact, rtol=0.05)
    assert stats.kstest(scores.numpy(), "chi2", args=(6,)).pvalue > 0.01


def test_the_score_is_per_context():
    flows = example_flow(contexts=4)
    chunks = torch.randn(4, 3, 2, generator=seeded(2), dtype=torch.float64)
    alone = [ReverseScore(steps=5)(GaussianFlow(flows.mean[i], flows.std[i]), chunks[i : i + 1]) for i in range(4)]
    assert torch.equal(ReverseScore(steps=5)(flows, chunks), torch.cat(alone))


def test_padding_is_left_out_of_the_norm_but_seen_by_the_flow(flow, chunks):
    expected = (factor(5, flow.std) * (chunks - flow.mean)).square().sum(2)
    score = ReverseScore(steps=5)
    assert torch.allclose(score(flow, chunks, length=2), expected[:, :2].sum(1))
    assert torch.equal(score(flow, chunks, length=3), score(flow, chunks))

    def coupled(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return x.mean(1, keepdim=True).expand_as(x)

    moved = chunks.clone()
    moved[:, 2] += 1
    assert (score(coupled, moved, length=2) != score(coupled, chunks, length=2)).all()


def test_the_score_rises_with_the_distance_from_the_expert(flow):
    away = torch.linspace(0, 5, 11, dtype=torch.float64)[:, None, None] * flow.std
    scores = ReverseScore(steps=5)(flow, flow.mean + away)
    assert (scores.diff() > 0).all()
    assert scores[0] < 1e-25


@pytest.mark.parametrize("steps", [0, -1])
def test_a_score_without_steps_is_refused(steps):
    with pytest.raises(ValueError, match=f"steps is {steps}, but must be at least 1"):
        ReverseScore(steps=steps)


def test_a_chunk_that_is_not_a_number_has_a_score_that_is_not_one(flow, chunks):
    chunks[3, 0, 0] = math.nan
    scores = ReverseScore(steps=5)(flow, chunks)
    assert scores.isnan().tolist() == [i == 3 for i in range(7)]
