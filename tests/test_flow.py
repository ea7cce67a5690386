"""Rectified flow against the Gaussian whose flow is known exactly."""

import math

import pytest
import torch

from lerobot_gloves.flow import endpoint, flow_matching_loss, integrate, interpolate
from tests.gaussian import GaussianFlow, example_flow, seeded


@pytest.fixture
def flow() -> GaussianFlow:
    return example_flow()


def noise(number: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(number, 3, 2, generator=seeded(seed), dtype=torch.float64)


def test_the_path_is_the_straight_line_from_noise_to_action():
    start, action = noise(3, 0), noise(3, 1)
    x = interpolate(start, action, torch.tensor([0.0, 0.25, 1.0], dtype=torch.float64))
    assert torch.equal(x[0], start[0])
    assert torch.allclose(x[1], 0.75 * start[1] + 0.25 * action[1], rtol=0, atol=1e-15)
    assert torch.equal(x[2], action[2])


@pytest.mark.parametrize(("start", "end"), [(0.0, 1.0), (1.0, 0.0), (0.3, 1.0), (0.8, 0.1)])
def test_integration_follows_the_exact_flow_map_with_order_one(flow, start, end):
    z = noise(5)
    x, exact = flow.position(z, start), flow.position(z, end)

    def error(steps: int) -> float:
        return (integrate(flow, x, start=start, end=end, steps=steps) - exact).abs().max().item()

    assert error(4000) < 5e-3
    # Halving the step of a first-order method halves its error; order two would give 4, no convergence 1.
    assert error(2000) / error(4000) == pytest.approx(2.0, abs=0.05)


def test_integration_goes_from_noise_to_action_in_ten_steps_unless_told_otherwise(flow):
    z = noise(2)
    x = z
    for k in range(10):
        x = x + 0.1 * flow(x, torch.full((2,), k / 10, dtype=torch.float64))
    assert torch.allclose(integrate(flow, z), x, rtol=0, atol=1e-14)


def test_integration_on_an_uneven_grid_is_euler_on_that_grid(flow):
    z = noise(2)
    x = z + 0.2 * flow(z, torch.zeros(2, dtype=torch.float64))
    x = x + 0.8 * flow(x, torch.full((2,), 0.2, dtype=torch.float64))
    assert torch.allclose(integrate(flow, z, grid=[0.0, 0.2, 1.0]), x, rtol=0, atol=1e-14)


def test_integrating_a_constant_velocity_is_exact_and_keeps_the_dtype():
    z = torch.zeros(2, 3, 2)
    x = integrate(lambda x, t: torch.full_like(x, 0.5), z, steps=4)
    assert x.dtype == torch.float32
    assert torch.equal(x, torch.full_like(z, 0.5))


@pytest.mark.parametrize("arguments", [{"steps": 0}, {"steps": -3}, {"grid": [0.0]}])
def test_integration_without_a_step_is_refused(flow, arguments):
    value = str(arguments.get("steps", 1))
    with pytest.raises(ValueError, match=f"{value}.*at least"):
        integrate(flow, noise(1), **arguments)


def test_the_endpoint_estimate_is_the_posterior_mean_of_the_action(flow):
    x, t = 2 * noise(6), torch.linspace(0, 1, 6, dtype=torch.float64)
    assert torch.allclose(endpoint(x, t, flow(x, t)), flow.posterior_mean(x, t), rtol=0, atol=1e-13)


def test_the_endpoint_estimate_is_the_regression_of_the_action_on_the_path(flow):
    """Not the formula but the statistics: a least-squares fit on sampled pairs (x_t, x_1)."""
    number, t = 200_000, 0.6
    action = flow.sample(number, seeded(3))
    x = interpolate(noise(number, 4), action, torch.full((number,), t, dtype=torch.float64))
    slope = ((x - x.mean(0)) * (action - action.mean(0))).mean(0) / x.var(0)
    fitted = action.mean(0) + slope * (1.0 - x.mean(0))
    point = torch.ones(1, 3, 2, dtype=torch.float64)
    time = torch.full((1,), t, dtype=torch.float64)
    assert torch.allclose(endpoint(point, time, flow(point, time))[0], fitted, rtol=0, atol=0.02)


def test_the_loss_of_the_exact_field_is_the_conditional_variance(flow):
    """var(x_1 - x_0 | x_t) = s^2 / w^2, whose integral over t in [0, 1] is pi s / 2."""
    loss = flow_matching_loss(flow, flow.sample(200_000, seeded(5)), generator=seeded(6))
    assert loss.shape == (200_000,)
    standard_error = loss.std().item() / math.sqrt(len(loss))
    assert loss.mean().item() == pytest.approx((math.pi * flow.std / 2).mean().item(), abs=4 * standard_error)


def test_the_exact_field_minimises_the_loss(flow):
    """The gradient vanishes in every direction of a family around it, and the loss is convex: a minimum."""
    actions = flow.sample(200_000, seeded(7))
    weights = torch.zeros(4, dtype=torch.float64, requires_grad=True)

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        time = t[:, None, None]
        features = torch.stack([torch.ones_like(x), x, time * x, torch.sin(3 * time) * torch.ones_like(x)])
        return flow(x, t) + torch.einsum("f,fnta->nta", weights, features)

    (gradient,) = torch.autograd.grad(flow_matching_loss(field, actions, generator=seeded(8)).mean(), weights)
    assert gradient.abs().max() < 0.02
    # And the test would notice: a field that is off by 0.1 has a gradient of 2 * 0.1 along the constant.
    weights.data[0] = 0.1
    (gradient,) = torch.autograd.grad(flow_matching_loss(field, actions, generator=seeded(8)).mean(), weights)
    assert gradient[0].item() == pytest.approx(0.2, abs=0.02)


def test_padding_counts_neither_in_the_loss_nor_in_its_gradient(flow):
    actions = flow.sample(4, seeded(9))
    mask = torch.arange(3) < torch.tensor([3, 2, 1, 0])[:, None]
    poisoned = actions.clone()
    poisoned[~mask] = 1e6
    clean = flow_matching_loss(flow, actions, mask=mask, generator=seeded(1))
    dirty = flow_matching_loss(flow, poisoned, mask=mask, generator=seeded(1))
    assert torch.equal(clean, dirty)
    assert clean[3] == 0
    assert clean[0] == flow_matching_loss(flow, actions, generator=seeded(1))[0]


def test_the_masked_loss_is_the_mean_over_the_actions_that_count():
    """A field that returns 0 has the error |x_1 - x_0|^2; with the noise known, the mean follows by hand."""
    action = torch.zeros(1, 2, 2, dtype=torch.float64)
    drawn = torch.randn(1, 2, 2, generator=seeded(2), dtype=torch.float64)
    loss = flow_matching_loss(
        lambda x, t: torch.zeros_like(x), action, mask=torch.tensor([[True, False]]), generator=seeded(2)
    )
    assert loss.item() == pytest.approx((drawn[0, 0] ** 2).mean().item())


def test_several_samples_of_a_chunk_are_averaged_over_adjacent_rows():
    """A field bound to B contexts gets the samples of one context in adjacent rows."""
    seen = []

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        seen.append((x, t))
        return torch.zeros_like(x)

    action = torch.stack([torch.full((2, 1), 100.0), torch.full((2, 1), -7.0)])
    loss = flow_matching_loss(field, action, samples=3, generator=seeded(0))
    noise = torch.randn(2, 3, 2, 1, generator=seeded(0))
    ((x, t),) = seen
    assert len(t.unique()) == 6
    time = t.view(2, 3, 1, 1)
    assert torch.allclose(x.view(2, 3, 2, 1), (1 - time) * noise + time * action[:, None])
    assert torch.allclose(loss, (action[:, None] - noise).square().mean((1, 2, 3)))


def test_times_are_uniform():
    seen = []

    def field(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        seen.append(t)
        return x

    flow_matching_loss(field, torch.zeros(20_000, 1, 1), generator=seeded(0))
    stats = pytest.importorskip("scipy.stats")
    assert stats.kstest(seen[0].double().numpy(), "uniform").pvalue > 0.01


def test_the_same_seed_gives_the_same_loss_and_another_seed_another(flow):
    actions = flow.sample(4, seeded(0))
    losses = [flow_matching_loss(flow, actions, generator=seeded(seed)) for seed in (1, 1, 2)]
    assert torch.equal(losses[0], losses[1])
    assert not torch.equal(losses[0], losses[2])
