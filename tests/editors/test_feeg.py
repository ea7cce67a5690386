"""FEEG on flows whose guided velocity is linear, so that every step can be written down.

On a Gaussian flow (`gaussian.py`) the endpoint estimate is E[x_1 | x_t], with derivative j, and the guided
velocity

    v~(x, t) = mu + g (x - t mu) - align * j * (mu + j (x - t mu) - a_u)

is affine in x, coordinate by coordinate.
"""

import pytest
import torch

from lerobot_gloves.editors import FEEG, Reference
from lerobot_gloves.flow import integrate
from tests.gaussian import GaussianFlow, example_flow, seeded


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def proposal(flow) -> torch.Tensor:
    return flow.mean + torch.randn(5, 3, 2, generator=seeded(0), dtype=torch.float64)


def recursion(flow: GaussianFlow, proposal: torch.Tensor, noise: torch.Tensor, editor: FEEG) -> torch.Tensor:
    """The affine recursion, one coordinate at a time in Python floats."""
    edited = torch.empty_like(proposal)
    for index in torch.cartesian_prod(*[torch.arange(n) for n in proposal.shape]).tolist():
        mu, s = flow.mean[tuple(index[1:])].item(), flow.std[tuple(index[1:])].item()
        a, t = proposal[tuple(index)].item(), editor.start
        x = t * a + (1 - t) * noise[tuple(index)].item()
        h = (1 - editor.start) / editor.steps
        for k in range(editor.steps):
            t = editor.start + k * h
            width = (1 - t) ** 2 + t**2 * s**2
            g, j = (t * s**2 - (1 - t)) / width, t * s**2 / width
            x += h * (mu + g * (x - t * mu) - editor.align * j * (mu + j * (x - t * mu) - a))
        edited[tuple(index)] = x
    return edited


@pytest.mark.parametrize(
    "editor",
    [FEEG(), FEEG(start=0.0), FEEG(start=0.8, steps=3), FEEG(align=0.0), FEEG(start=0.2, steps=1, align=5.0)],
    ids=str,
)
def test_an_edit_is_the_recursion_by_hand(flow, proposal, editor):
    noise = torch.randn(5, 3, 2, generator=seeded(1), dtype=torch.float64)
    edited = editor(proposal, Reference(flow, generator=seeded(1)))
    assert torch.allclose(edited, recursion(flow, proposal, noise, editor), rtol=0, atol=1e-12)


def test_without_guidance_an_edit_is_the_flow_from_the_noised_proposal(flow, proposal):
    noise = torch.randn(5, 3, 2, generator=seeded(1), dtype=torch.float64)
    expected = integrate(flow, 0.3 * proposal + 0.7 * noise, start=0.3, end=1.0, steps=7)
    edited = FEEG(start=0.3, steps=7, align=0.0)(proposal, Reference(flow, generator=seeded(1)))
    assert torch.allclose(edited, expected, rtol=0, atol=1e-13)


def test_without_guidance_no_gradient_is_computed():
    seen = []

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        seen.append(x.requires_grad or torch.is_grad_enabled())
        return -x

    for align in (0.0, 0.1):
        FEEG(steps=3, align=align)(torch.ones(2, 3, 2), Reference(field, generator=seeded(1)))
    assert seen == [False] * 3 + [True] * 3


def test_the_gradient_is_pulled_back_by_the_transposed_jacobian():
    """A field that couples the actions without symmetry: v = M x, so x_1_hat = (I + (1 - t) M) x."""
    matrix = torch.tensor([[0.2, -1.0], [0.5, 0.1]], dtype=torch.float64)
    proposal = torch.tensor([[[1.0], [-2.0]]], dtype=torch.float64)
    edited = FEEG(start=0.4, steps=2, align=0.7)(proposal, Reference(lambda x, t: matrix @ x, generator=seeded(3)))
    x = 0.4 * proposal + 0.6 * torch.randn(1, 2, 1, generator=seeded(3), dtype=torch.float64)
    for t in (0.4, 0.7):
        jacobian = torch.eye(2, dtype=torch.float64) + (1 - t) * matrix
        x = x + 0.3 * (matrix @ x - 0.7 * jacobian.T @ (jacobian @ x - proposal))
    assert torch.allclose(edited, x, rtol=0, atol=1e-14)


def test_a_field_that_does_not_look_at_the_action_has_the_identity_as_jacobian(proposal):
    """v = c, so x_1_hat = x + (1 - t) c and its derivative is the identity."""
    edited = FEEG(start=0.5, steps=1)(proposal, Reference(lambda x, t: torch.full_like(x, 0.3), generator=seeded(3)))
    x = 0.5 * proposal + 0.5 * torch.randn(5, 3, 2, generator=seeded(3), dtype=torch.float64)
    assert torch.allclose(edited, x + 0.5 * (0.3 - (x + 0.15 - proposal)), rtol=0, atol=1e-14)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_from_the_end_nothing_is_edited(proposal, flow, dtype):
    proposal = proposal.to(dtype)
    flow = GaussianFlow(flow.mean.to(dtype), flow.std.to(dtype))
    edited = FEEG(start=1.0)(proposal, Reference(flow, generator=seeded(0)))
    assert edited.dtype == dtype
    assert torch.equal(edited, proposal)


def test_from_the_end_not_even_a_broken_field_edits(proposal):
    edited = FEEG(start=1.0)(proposal, Reference(lambda x, t: torch.full_like(x, torch.nan), generator=seeded(0)))
    assert torch.equal(edited, proposal)


def test_guidance_pulls_the_edit_towards_the_proposal(flow, proposal):
    distances = [
        (FEEG(start=0.0, align=align)(proposal, Reference(flow, generator=seeded(4))) - proposal).norm().item()
        for align in (0.0, 0.5, 1.0, 2.0)
    ]
    assert distances == sorted(distances, reverse=True)


def test_without_guidance_the_beginning_forgets_the_proposal(flow, proposal):
    editor = FEEG(start=0.0, align=0.0)
    one, other = (editor(chunk, Reference(flow, generator=seeded(5))) for chunk in (proposal, proposal + 3))
    assert torch.equal(one, other)


def test_an_edit_brings_a_distant_proposal_to_the_expert(flow):
    distant = flow.mean + 6 * flow.std * torch.tensor([1.0, -1.0], dtype=torch.float64)
    edited = FEEG(start=0.2)(distant.expand(50, 3, 2), Reference(flow, generator=seeded(6)))
    narrow = flow.std < 0.5
    before = ((distant - flow.mean) / flow.std).abs()[narrow]
    after = ((edited - flow.mean) / flow.std).abs().mean(0)[narrow]
    assert (after < before / 2).all()


def network() -> torch.nn.Module:
    """A small field with parameters, which couples the actions of a chunk."""
    torch.manual_seed(0)
    layers = torch.nn.Sequential(torch.nn.Linear(7, 16), torch.nn.SiLU(), torch.nn.Linear(16, 6))

    class Field(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = layers

        def forward(self, x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
            return self.layers(torch.cat([x.flatten(1), t[:, None]], dim=1)).view_as(x)

    return Field()


def test_inference_mode_changes_nothing():
    field, proposal = network(), torch.randn(4, 3, 2, generator=seeded(7))
    expected = FEEG()(proposal, Reference(field, generator=seeded(8)))
    with torch.inference_mode():
        edited = FEEG()(proposal.clone(), Reference(field, generator=seeded(8)))
    with torch.no_grad():
        quiet = FEEG()(proposal, Reference(field, generator=seeded(8)))
    assert torch.equal(edited, expected)
    assert torch.equal(quiet, expected)


def test_an_edit_leaves_no_trace_in_network_or_proposal():
    field, proposal = network(), torch.randn(4, 3, 2, generator=seeded(7))
    before = proposal.clone()
    edited = FEEG()(proposal, Reference(field, generator=seeded(8)))
    assert not edited.requires_grad
    assert all(parameter.grad is None for parameter in field.parameters())
    assert torch.equal(proposal, before)
    assert not proposal.requires_grad


def test_the_same_seed_edits_alike_and_another_one_otherwise(flow, proposal):
    edits = [FEEG()(proposal, Reference(flow, generator=seeded(seed))) for seed in (1, 1, 2)]
    assert torch.equal(edits[0], edits[1])
    assert not torch.equal(edits[0], edits[2])


def test_an_environment_is_edited_alike_in_any_batch(proposal):
    flows = example_flow(contexts=5)
    batch = FEEG()(proposal, Reference(flows, generator=[seeded(i) for i in range(5)]))
    for i in range(5):
        alone = GaussianFlow(flows.mean[i], flows.std[i])
        assert torch.equal(FEEG()(proposal[i : i + 1], Reference(alone, generator=[seeded(i)])), batch[i : i + 1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": -0.1}, r"start is -0\.1, but must lie in \[0, 1\]"),
        ({"start": 1.1}, r"start is 1\.1"),
        ({"start": float("nan")}, "start is nan"),
        ({"steps": 0}, "steps is 0, but must be at least 1"),
    ],
)
def test_bad_parameters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        FEEG(**arguments)
