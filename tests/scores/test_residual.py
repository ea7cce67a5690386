"""The residual score on a Gaussian flow, where the loss of a chunk can be written down.

With d = x - mu, the residual at x_t is linear in d and the noise z, a coordinate

    v - (x - z) = (t s^2 z - (1 - t) d) / w^2,        w^2 = (1 - t)^2 + t^2 s^2,

so a pair z, -z has the mean square ((1 - t)^2 d^2 + t^2 s^4 z^2) / w^4: what is drawn adds a constant.
"""

import math

import pytest
import torch

from lerobot_gloves.scores import ResidualScore
from tests.gaussian import GaussianFlow, example_flow, seeded, two_modes


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def chunks() -> torch.Tensor:
    return 2 * torch.randn(7, 3, 2, generator=seeded(0), dtype=torch.float64)


def of_distance(flow: GaussianFlow, chunks: torch.Tensor, times: list[float]) -> torch.Tensor:
    """The part of the residual, coordinate by coordinate, that the distance from the mean makes."""
    weight = [((1 - t) / ((1 - t) ** 2 + t**2 * flow.std**2)) ** 2 for t in times]
    return torch.stack(weight).mean(0) * (chunks - flow.mean) ** 2


@pytest.mark.parametrize("pairs", [1, 3])
def test_the_score_is_the_weighted_distance_whatever_was_drawn(flow, chunks, pairs):
    expected = of_distance(flow, chunks, [0.1, 0.3, 0.5, 0.7, 0.9]).sum((1, 2))
    for seed in (0, 1):
        score = ResidualScore(pairs=pairs, seed=seed)
        drawn = score(flow, chunks) - score(flow, flow.mean[None])
        assert torch.allclose(drawn, expected, rtol=1e-9)


def test_what_is_drawn_has_the_mean_of_the_loss(flow):
    """E z^2 = 1, so a chunk at the mean scores the mean over t of the sum of t^2 s^4 / w^4."""
    times = [1 / 6, 3 / 6, 5 / 6]
    expected = sum((t * flow.std**2 / ((1 - t) ** 2 + t**2 * flow.std**2)) ** 2 for t in times).sum() / 3
    score = ResidualScore(times=3, pairs=4000)(flow, flow.mean[None])
    assert score.item() == pytest.approx(expected.item(), rel=0.05)


def test_the_flow_is_called_once_at_the_midpoints_with_the_rows_of_a_chunk_adjacent(chunks):
    seen = []

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        seen.append((x, t))
        return torch.zeros_like(x)

    ResidualScore(times=4, pairs=2)(field, chunks)
    ((x, t),) = seen
    assert x.shape == (7 * 16, 3, 2)
    assert sorted(set(t.tolist())) == [0.125, 0.375, 0.625, 0.875]
    # Both noises of a pair meet their chunk at one time: the mean of the two points is t x.
    first, second = x.view(7, 2, 8, 3, 2).unbind(1)
    assert torch.allclose((first + second) / 2, t.view(7, 2, 8)[:, 0, :, None, None] * chunks[:, None])


def test_the_score_is_per_context():
    flows = example_flow(contexts=4)
    chunks = torch.randn(4, 3, 2, generator=seeded(2), dtype=torch.float64)
    alone = [ResidualScore()(GaussianFlow(flows.mean[i], flows.std[i]), chunks[i : i + 1]) for i in range(4)]
    assert torch.allclose(ResidualScore()(flows, chunks), torch.cat(alone), rtol=1e-12)


def test_padding_is_left_out_of_the_norm_but_seen_by_the_flow(flow, chunks):
    score = ResidualScore()
    expected = of_distance(flow, chunks, [0.1, 0.3, 0.5, 0.7, 0.9])[:, :2].sum((1, 2))
    assert torch.allclose(score(flow, chunks, length=2) - score(flow, flow.mean[None], length=2), expected)
    assert torch.equal(score(flow, chunks, length=3), score(flow, chunks))

    def coupled(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return x.mean(1, keepdim=True).expand_as(x)

    moved = chunks.clone()
    moved[:, 2] += 1
    assert (score(coupled, moved, length=2) != score(coupled, chunks, length=2)).all()


def test_between_two_modes_is_less_like_the_expert_than_in_one():
    flow = two_modes(std=0.1)
    mode = flow.modes[0].mean
    at, between = ResidualScore()(flow, torch.stack([mode, 0 * mode]))
    assert between > 2 * at


@pytest.mark.parametrize("options", [{"times": 0}, {"pairs": 0}])
def test_a_score_without_draws_is_refused(options):
    with pytest.raises(ValueError, match="times and pairs must be at least 1, got"):
        ResidualScore(**options)


def test_a_chunk_that_is_not_a_number_has_a_score_that_is_not_one(flow, chunks):
    chunks[3, 0, 0] = math.nan
    assert ResidualScore()(flow, chunks).isnan().tolist() == [i == 3 for i in range(7)]
