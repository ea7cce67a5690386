"""FPAS against the paper's equations written in numpy, and against what the paper says of it."""

import math

import numpy as np
import pytest
import torch

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.editors import FPAS, Reference
from lerobot_gloves.generators import Generators, randn
from lerobot_gloves.scores import ReverseScore
from tests.gaussian import GaussianFlow, example_flow, seeded

SCORE = ReverseScore(steps=5)


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def proposal(flow) -> torch.Tensor:
    return flow.mean + torch.randn(4, 3, 2, generator=seeded(0), dtype=torch.float64)


@pytest.fixture
def threshold(flow) -> float:
    return ConformalGate(SCORE(flow, flow.sample(500, seeded(9)))).threshold


def against(flow, threshold: float, generator: Generators = None, **options: int) -> Reference:
    return Reference(flow, score=SCORE, threshold=threshold, generator=generator, **options)


def numpy_score(chunk: np.ndarray, mean: np.ndarray, std: np.ndarray, steps: int = 5) -> float:
    """Five backward Euler steps of the exact velocity, one chunk."""
    x = chunk
    for k in range(steps):
        t = 1 - k / steps
        gain = (t * std**2 - (1 - t)) / ((1 - t) ** 2 + t**2 * std**2)
        x = x - (mean + gain * (x - t * mean)) / steps
    return float((x**2).sum())


def paper(proposal: np.ndarray, flow: GaussianFlow, noise: np.ndarray, threshold: float, editor: FPAS) -> np.ndarray:
    """The equations of the section "FPAS" for one chunk; `noise` (K, n, T, A) is standard normal."""
    mean, std, chunk = flow.mean.numpy(), flow.std.numpy(), proposal.copy()
    for k in range(editor.iterations):
        perturbations = editor.sigma * noise[k]
        perturbations[0] = 0.0
        losses = []
        for perturbation in perturbations:
            candidate = chunk + perturbation
            violation = max(numpy_score(candidate, mean, std) - threshold, 0.0)
            losses.append(violation + editor.align * ((candidate - proposal) ** 2).sum())
        weights = np.exp(-(np.array(losses) - min(losses)))
        weights /= weights.sum()
        chunk = chunk + editor.edit * sum(w * e for w, e in zip(weights, perturbations, strict=True))
    return chunk


@pytest.mark.parametrize(
    "editor",
    [FPAS(), FPAS(iterations=3, candidates=8, sigma=0.4, edit=0.7, align=1.0), FPAS(align=0.0, iterations=1)],
    ids=str,
)
def test_an_edit_is_the_papers_equations(flow, proposal, threshold, editor):
    shape = (editor.iterations, editor.candidates, 3, 2)
    noises = []
    for i in range(4):
        generator = seeded(i)
        draws = [torch.randn(shape[1:], generator=generator, dtype=torch.float64) for _ in range(shape[0])]
        noises.append(torch.stack(draws).numpy())
    edited = editor(proposal, against(flow, threshold, [seeded(i) for i in range(4)]))
    for i in range(4):
        expected = paper(proposal[i].numpy(), flow, noises[i], threshold, editor)
        np.testing.assert_allclose(edited[i].numpy(), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_edit_strength_no_edit(flow, proposal, threshold, dtype):
    proposal = proposal.to(dtype)
    edited = FPAS(edit=0.0)(proposal, against(flow, threshold, seeded(0)))
    assert edited.dtype == dtype
    assert torch.equal(edited, proposal)


def test_one_candidate_is_the_unperturbed_chunk(flow, proposal, threshold):
    assert torch.equal(FPAS(candidates=1)(proposal, against(flow, threshold, seeded(0))), proposal)


def test_an_edit_lowers_the_score_of_a_chunk_that_the_gate_rejects(flow, threshold):
    direction = torch.randn(64, 3, 2, generator=seeded(1), dtype=torch.float64)
    rejected = flow.mean + 6 * flow.std * direction / direction.square().mean((1, 2), keepdim=True).sqrt()
    before = SCORE(flow, rejected)
    assert (before > threshold).all()
    after = SCORE(flow, FPAS(iterations=20)(rejected, against(flow, threshold, seeded(2))))
    assert (after < before).all()
    assert (after - threshold).clamp(min=0).mean() < 0.5 * (before - threshold).mean()


def test_a_chunk_that_the_gate_admits_is_nearly_unchanged(flow, threshold):
    """Where the hinge is flat, an iteration moves by the mean of n perturbations, of which one is 0.

    With align = 0 that is a random walk: per coordinate and after K iterations, sigma sqrt(K (n - 1)) / n.
    """
    admitted = flow.mean.expand(500, 3, 2)
    editor = FPAS(sigma=0.02, align=0.0)
    moved = editor(admitted, against(flow, threshold, seeded(3))) - admitted
    assert moved.square().mean().sqrt().item() == pytest.approx(0.02 * math.sqrt(5 * 15) / 16, rel=0.05)
    many = FPAS(sigma=0.02, align=0.0, candidates=512)(admitted, against(flow, threshold, seeded(3))) - admitted
    assert many.square().mean().sqrt() < 0.3 * moved.square().mean().sqrt()


def test_the_pull_towards_the_proposal_shortens_the_edit(flow, threshold):
    rejected = (flow.mean + 4 * flow.std).expand(64, 3, 2)
    moved = [
        (FPAS(align=align, sigma=0.3)(rejected, against(flow, threshold, seeded(4))) - rejected).norm().item()
        for align in (0.0, 5.0, 50.0)
    ]
    assert moved == sorted(moved, reverse=True)


def test_every_context_gets_its_own_candidates(threshold):
    """One chunk under four contexts: each edit goes towards the expert of its own context."""
    means = torch.tensor([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]], dtype=torch.float64)[:, None]
    flow = GaussianFlow(means, torch.full_like(means, 0.1))
    proposal = torch.zeros(4, 1, 2, dtype=torch.float64)
    edited = FPAS(iterations=10, candidates=64)(proposal, against(flow, 1.0, seeded(5)))
    assert (edited.sign() == means.sign()).all()
    assert ((edited - means).norm(dim=(1, 2)) < 0.5 * (proposal - means).norm(dim=(1, 2))).all()


@pytest.mark.parametrize("threshold", [-math.inf, math.inf])
def test_a_gate_that_admits_nothing_or_everything_still_gives_finite_chunks(flow, proposal, threshold):
    """ConformalGate's threshold at alpha 1, and with too few calibration scores."""
    assert FPAS()(proposal, against(flow, threshold, seeded(6))).isfinite().all()


def test_padding_has_no_say_in_what_is_executed(flow, proposal, threshold, monkeypatch):
    """Whether candidates differ behind the actions that count or not, these are edited alike."""
    noise = randn((4 * 16, 3, 2), seeded(3), like=proposal)
    edits = []
    for behind in (1.0, 0.0):
        drawn = torch.cat([noise[:, :2], behind * noise[:, 2:]], dim=1)
        monkeypatch.setattr("lerobot_gloves.editors.fpas.randn", lambda *_, drawn=drawn, **__: drawn)
        # One iteration: in later ones this flow, like any other, sees all actions.
        edits.append(FPAS(iterations=1, align=1.0, sigma=1.0)(proposal, against(flow, threshold, length=2))[:, :2])
    assert (edits[0] != proposal[:, :2]).any()
    torch.testing.assert_close(*edits)


def test_an_edit_needs_no_gradient_and_leaves_no_trace(proposal):
    field = torch.nn.Linear(2, 2, dtype=torch.float64)
    before = proposal.clone()
    edited = FPAS()(proposal, against(lambda x, t: field(x), 0.0, seeded(7)))
    assert not edited.requires_grad
    assert torch.equal(proposal, before)


def test_inference_mode_changes_nothing(flow, proposal, threshold):
    expected = FPAS()(proposal, against(flow, threshold, seeded(8)))
    with torch.inference_mode():
        assert torch.equal(FPAS()(proposal, against(flow, threshold, seeded(8))), expected)


def test_the_same_seed_edits_alike_and_another_one_otherwise(flow, proposal, threshold):
    edits = [FPAS()(proposal, against(flow, threshold, seeded(seed))) for seed in (1, 1, 2)]
    assert torch.equal(edits[0], edits[1])
    assert not torch.equal(edits[0], edits[2])


def test_an_environment_is_edited_alike_in_any_batch(proposal):
    flows = example_flow(contexts=4)
    batch = FPAS()(proposal, against(flows, 1.0, [seeded(i) for i in range(4)]))
    for i in range(4):
        alone = GaussianFlow(flows.mean[i], flows.std[i])
        assert torch.equal(FPAS()(proposal[i : i + 1], against(alone, 1.0, [seeded(i)])), batch[i : i + 1])


@pytest.mark.parametrize("given", [{}, {"score": SCORE}, {"threshold": 1.0}])
def test_without_score_and_threshold_there_is_nothing_to_search_below(flow, proposal, given):
    with pytest.raises(ValueError, match=r"FPAS searches below .* threshold (None|1\.0): calibrate"):
        FPAS()(proposal, Reference(flow, **given))


@pytest.mark.parametrize("arguments", [{"iterations": 0}, {"candidates": 0}, {"sigma": -0.1}])
def test_bad_parameters_are_refused(arguments):
    ((name, value),) = arguments.items()
    with pytest.raises(ValueError, match=rf"{name}.*{value}"):
        FPAS(**arguments)
