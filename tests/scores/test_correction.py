"""The correction score where the posterior is known, and several scores as one."""

import math

import pytest
import torch

from lerobot_gloves.editors import FPAS, Reference
from lerobot_gloves.flow import VelocityField
from lerobot_gloves.scores import CorrectionScore, Joint, ResidualScore, ReverseScore
from lerobot_gloves.scores.joint import excess
from tests.gaussian import GaussianFlow, seeded


def posterior(proposal: torch.Tensor, spread: float, noise: float) -> VelocityField:
    """The flow of an expert N(0, spread^2), given that its action plus N(0, noise^2) was proposed."""
    kept = spread**2 / (spread**2 + noise**2)
    return GaussianFlow(kept * proposal, torch.full_like(proposal, spread * math.sqrt(1 - kept)))


def test_it_is_how_far_the_posteriors_mean_lies_from_the_chunk():
    chunk = torch.tensor([3.0, 4.0]).expand(2, 5, 2).double() * torch.tensor([1.0, 2.0])[:, None, None]
    # Of (3, 4), 5 long, a noise of the expert's own spread is half: the mean lies 2.5 away. A sixteenth: 1/17.
    for noise, share in ((1.0, 1 / 2), (0.25, 1 / 17)):
        found = CorrectionScore()(None, chunk, posterior=posterior(chunk, 1.0, noise))
        assert found.tolist() == pytest.approx([5 * share, 10 * share])


def test_only_the_actions_that_count_count():
    chunk = torch.zeros(1, 4, 2).double()
    mean = torch.tensor([0.0, 1.0, 5.0, 100.0]).double()[None, :, None] * torch.tensor([1.0, 0.0])
    found = [CorrectionScore()(None, chunk, length=n, posterior=GaussianFlow(mean, mean + 1)).item() for n in (1, 2, 3)]
    assert found == pytest.approx([0.0, 0.5, 2.0])


def test_a_repetition_is_infinitely_unlike_the_expert():
    chunk = torch.zeros(3, 2, 1)
    repeated = torch.tensor([False, True, False])
    found = CorrectionScore()(None, chunk, posterior=posterior(chunk, 1.0, 1.0), repeated=repeated)
    assert found.tolist() == [0.0, math.inf, 0.0]


def test_without_a_posterior_it_says_what_it_takes():
    with pytest.raises(ValueError, match="correction needs an adapter that reads proposals: take a gloves_copilot"):
        CorrectionScore()(None, torch.zeros(1, 2, 1))


def test_an_excess_is_over_the_worst_threshold():
    scores = torch.tensor([[1.0, 3.0, 0.0, math.inf, math.inf], [5.0, 5.0, 6.5, 0.0, 0.0]])
    assert excess(scores, (2.0, 5.0)).tolist() == [0.0, 1.0, 1.5, math.inf, math.inf]
    assert excess(scores, (math.inf, 6.0)).tolist() == [-1.0, -1.0, 0.5, 0.0, 0.0], "an infinite threshold admits all"


def test_several_scores_as_one_are_each_asked_what_they_ask_for():
    chunk = torch.randn((4, 3, 2), generator=seeded(0), dtype=torch.float64)
    expert = GaussianFlow(torch.zeros(3, 2).double(), torch.full((3, 2), 0.5).double())
    told = {"posterior": posterior(chunk, 0.5, 0.5)}
    apart = [ReverseScore(steps=3)(expert, chunk, length=2), CorrectionScore()(expert, chunk, length=2, **told)]
    thresholds = tuple(one.median().item() for one in apart)
    joint = Joint((ReverseScore(steps=3), CorrectionScore()), thresholds)
    assert joint.needs_posterior and joint.starts_at_chunk
    assert (
        not Joint((ReverseScore(),), (1.0,)).needs_posterior and not Joint((ResidualScore(),), (1.0,)).starts_at_chunk
    )
    found = joint(expert, chunk, length=2, **told)
    torch.testing.assert_close(
        found, torch.stack([one - bound for one, bound in zip(apart, thresholds, strict=True)]).amax(dim=0)
    )


def test_fpas_searches_below_the_distance_to_the_mean():
    """The candidates are told the same proposal, and none of them repeats it."""
    proposal = torch.full((2, 3, 2), 2.0).double()
    reference = Reference(
        expert=GaussianFlow(torch.zeros(3, 2).double(), torch.ones(3, 2).double()),
        posterior=posterior(proposal, 1.0, 1.0),
        repeated=torch.tensor([False, True]),
        score=CorrectionScore(),
        threshold=0.0,
        generator=seeded(0),
    )
    before = reference.nonconformity(proposal)
    edited = FPAS(iterations=30, candidates=64, sigma=0.3, align=0.0)(proposal, reference)
    assert edited.isfinite().all() and (reference.nonconformity(edited) < 0.9 * before).all()
