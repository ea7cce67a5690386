"""The self-normalised score on flows whose samples and spread are known exactly."""

import math

import pytest
import torch

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.scores import ReverseScore, SelfNormalisedScore
from tests.gaussian import GaussianFlow, example_flow, seeded, two_modes

ALPHA = 0.1
EXACT = 40
"""Steps after which a sample is all but the exact one."""


def gaussian(std: float, mean: float = 0.5) -> GaussianFlow:
    return GaussianFlow(*(torch.full((3, 2), value, dtype=torch.float64) for value in (mean, std)))


def test_the_score_is_what_the_exact_samples_say():
    """On a Gaussian flow a sample is mu + s z, and residuals differ as weighted distances do, see test_residual.py."""
    flow = example_flow()
    noise = torch.randn(5, 3, 2, generator=seeded(3), dtype=torch.float64)
    times = [1 / 6, 3 / 6, 5 / 6]
    weight = sum(((1 - t) / ((1 - t) ** 2 + t**2 * flow.std**2)) ** 2 for t in times) / 3
    samples = (weight * (flow.std * noise) ** 2).sum((1, 2))
    chunks = flow.sample(7, seeded(0))
    expected = ((weight * (chunks - flow.mean) ** 2).sum((1, 2)) - samples.mean()) / samples.std()
    score = SelfNormalisedScore(samples=5, steps=1500, floor=0.0, seed=3)(flow, chunks)
    assert torch.allclose(score, expected, rtol=0.01, atol=0.01)
    assert expected.max() - expected.min() > 1


@pytest.mark.parametrize("factor", [4.0, 0.25])
def test_the_spread_is_the_unit(factor):
    """Chunks as many standard deviations away score alike in a narrow and in a wide context."""
    away = torch.linspace(-3, 3, 9, dtype=torch.float64)[:, None, None]
    score = SelfNormalisedScore(steps=EXACT)
    one, other = gaussian(0.2), gaussian(0.2 * factor)
    first, second = (score(flow, flow.mean + away * flow.std) for flow in (one, other))
    assert torch.allclose(first, second, rtol=0.1)


def level_and_power(score: object) -> tuple[list[float], float]:
    """Of one gate for a precise and a loose context: levels in both, and how often it sees a shift in the precise."""
    flows = [gaussian(0.1), gaussian(0.8)]
    calibration = torch.cat([score(flow, flow.sample(600, seeded(0))) for flow in flows])
    gate = ConformalGate(calibration, alpha=ALPHA)
    turned = [1 - gate.admits(score(flow, flow.sample(600, seeded(1)))).double().mean().item() for flow in flows]
    shifted = flows[0].sample(600, seeded(2)) + 3 * flows[0].std
    return turned, 1 - gate.admits(score(flows[0], shifted)).double().mean().item()


def test_one_threshold_keeps_its_level_in_contexts_of_different_spread():
    """The reverse score's does not: it never turns away in the precise context, twice too often in the loose one."""
    (precise, loose), seen = level_and_power(SelfNormalisedScore())
    assert abs(precise - ALPHA) < 0.05 and abs(loose - ALPHA) < 0.05
    assert seen > 0.9
    (precise, loose), seen = level_and_power(ReverseScore(steps=2))
    assert precise == 0 and loose > 1.8 * ALPHA
    assert seen < 0.1


def test_what_lies_between_two_modes_is_not_the_experts():
    """The reverse score finds it the most likely of all: the flow takes it to the middle of the noise."""
    flow = two_modes(std=0.1)
    chunks = torch.stack([flow.modes[0].mean, flow.modes[1].mean, 0 * flow.modes[0].mean])
    expert = flow.sample(500, seeded(0))
    score = SelfNormalisedScore()
    *modes, between = score(flow, chunks)
    assert max(modes) < score(flow, expert).quantile(0.9)
    assert between > 3 * score(flow, expert).max()
    assert ReverseScore(steps=5)(flow, chunks)[2] < ReverseScore(steps=5)(flow, expert).quantile(0.1)


def test_the_score_rises_with_the_distance_from_the_expert():
    flow = example_flow()
    away = torch.linspace(0, 8, 17, dtype=torch.float64)[:, None, None] * flow.std
    scores = SelfNormalisedScore()(flow, flow.mean + away)
    assert (scores[4:].diff() > 0).all()


def test_the_floor_is_a_share_of_the_mean_and_a_flow_without_spread_has_finite_scores():
    flow = gaussian(0.2)
    chunks = flow.sample(7, seeded(0))
    high, higher = (SelfNormalisedScore(floor=floor)(flow, chunks) for floor in (5.0, 10.0))
    assert torch.allclose(high, 2 * higher)

    def still(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        """The exact field of an expert that always acts alike."""
        return (flow.mean - x) / (1 - t)[:, None, None].clamp(min=1e-9)

    assert SelfNormalisedScore()(still, chunks).isfinite().all()


def test_the_score_is_per_context_and_of_adjacent_rows():
    flows = example_flow(contexts=4)
    chunks = torch.randn(4, 3, 2, generator=seeded(2), dtype=torch.float64)
    score = SelfNormalisedScore()
    alone = [score(GaussianFlow(flows.mean[i], flows.std[i]), chunks[i : i + 1]) for i in range(4)]
    assert torch.allclose(score(flows, chunks), torch.cat(alone), rtol=1e-12)
    assert torch.allclose(score(flows, chunks.repeat_interleave(3, dim=0))[::3], torch.cat(alone), rtol=1e-12)


def test_the_same_chunk_scores_the_same_every_time_and_by_another_seed_otherwise():
    flow = example_flow()
    chunks = flow.sample(5, seeded(0))
    torch.manual_seed(0)
    first = SelfNormalisedScore()(flow, chunks)
    torch.manual_seed(1)
    assert torch.equal(SelfNormalisedScore()(flow, chunks), first)
    assert not torch.equal(SelfNormalisedScore(seed=1)(flow, chunks), first)


def test_padding_is_left_out_of_the_norms_but_seen_by_the_flow():
    flow, score = example_flow(), SelfNormalisedScore()
    chunks = flow.sample(7, seeded(0))
    assert torch.equal(score(flow, chunks, length=3), score(flow, chunks))
    moved = chunks.clone()
    moved[:, 2] += 1
    assert torch.allclose(score(flow, moved, length=2), score(flow, chunks, length=2))  # actions are independent here

    def coupled(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return x.mean(1, keepdim=True).expand_as(x)

    assert (score(coupled, moved, length=2) != score(coupled, chunks, length=2)).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 1}, "samples is 1, but must be at least 2"),
        ({"steps": 0}, "steps and times must be at least 1, got"),
        ({"times": 0}, "steps and times must be at least 1, got"),
        ({"floor": -0.1}, "floor is -0.1, but must not be negative"),
        ({"floor": math.nan}, "floor is nan, but must not be negative"),
    ],
)
def test_settings_that_mean_nothing_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        SelfNormalisedScore(**options)


def test_a_chunk_that_is_not_a_number_has_a_score_that_is_not_one():
    flow = example_flow()
    chunks = flow.sample(7, seeded(0))
    chunks[3, 0, 0] = math.nan
    assert SelfNormalisedScore()(flow, chunks).isnan().tolist() == [i == 3 for i in range(7)]
