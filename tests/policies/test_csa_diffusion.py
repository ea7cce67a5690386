"""Karras' diffusion, its distillation and CSA, against what is known of normally distributed actions (see `normal`)."""

import copy
import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn

from lerobot_gloves.editors import Reference
from lerobot_policy_csa_assist.consistency import distillation_loss
from lerobot_policy_csa_assist.editor import CSA
from lerobot_policy_csa_assist.edm import Denoiser, NoiseLevels, edm_loss, heun, solve
from tests.gaussian import seeded
from tests.policies.normal import DOUBLE, MEAN, STD, Exact, chunks, flowed

# --- Noise levels ---


@pytest.mark.parametrize(
    ("levels", "level", "sigma", "digits"),
    [(80, 60, 0.15, 2), (80, 10, 38.6, 1), (30, 9, 11.5, 1), (80, 0, 80, 6), (80, 79, 0.002, 6)],
)
def test_levels_are_counted_as_flashback_counts_them(levels, level, sigma, digits):
    grid = NoiseLevels(levels=levels).grid(like=DOUBLE)
    assert grid.shape == (levels,) and round(grid[level].item(), digits) == sigma


def test_the_grid_is_even_in_the_rho_th_root():
    grid = NoiseLevels(sigma_min=0.01, sigma_max=9.0, rho=3.0, levels=12).grid(like=DOUBLE)
    roots = torch.tensor([sigma.item() ** (1 / 3) for sigma in grid], dtype=torch.float64)
    torch.testing.assert_close(roots, torch.linspace(9.0 ** (1 / 3), 0.01 ** (1 / 3), 12, dtype=torch.float64))


def test_the_networks_time_runs_from_noise_to_action_and_tells_levels_apart():
    noise = NoiseLevels()
    time = noise.time(noise.grid(like=DOUBLE))
    assert time[0] == pytest.approx(0) and time[-1] == pytest.approx(1)
    assert time.diff().min() > 0.0065
    assert noise.time(torch.tensor(0.4)) == pytest.approx(0.5)  # the geometric mean of 0.002 and 80


# --- The denoiser ---


@pytest.mark.parametrize("sigma", [0.01, 0.5, 30.0])
def test_the_scalings_give_the_network_inputs_and_targets_of_unit_variance(sigma):
    noise, given = NoiseLevels(sigma_data=0.7), []
    denoiser = Denoiser(lambda x, t: given.append(x) or torch.ones_like(x), noise)
    action = 0.7 * torch.randn((50_000, 1, 1), generator=seeded(0), dtype=torch.float64)
    noisy = action + sigma * torch.randn(action.shape, generator=seeded(1), dtype=torch.float64)
    sigmas = torch.full((len(noisy),), sigma, dtype=torch.float64)
    with_one = denoiser(noisy, sigmas)
    with_none = Denoiser(lambda x, t: torch.zeros_like(x), noise)(noisy, sigmas)
    target = (action - with_none) / (with_one - with_none)  # what F should say, by solving D = action for it
    assert given[0].std() == pytest.approx(1, abs=0.02)
    assert target.std() == pytest.approx(1, abs=0.02)


def test_a_consistency_function_leaves_what_is_at_the_smallest_sigma():
    noise = NoiseLevels(sigma_min=0.05)
    student = Denoiser(lambda x, t: x.exp() + 7, noise, identity=0.05)
    x = chunks(4)
    assert torch.equal(student(x, torch.full((4,), 0.05, dtype=torch.float64)), x)
    assert (student(x, torch.full((4,), 0.06, dtype=torch.float64)) != x).all()


def test_far_above_the_smallest_sigma_it_is_the_denoiser_that_it_starts_from():
    def network(x: Tensor, t: Tensor) -> Tensor:
        return x.sin() + t[:, None, None]

    x, sigma = chunks(5), torch.tensor([1.0, 3.0, 10.0, 30.0, 80.0], dtype=torch.float64)
    teacher, student = Denoiser(network, NoiseLevels()), Denoiser(network, NoiseLevels(), identity=0.002)
    torch.testing.assert_close(student(x, sigma), teacher(x, sigma), rtol=0, atol=3e-3)


# --- The teacher's loss ---


@pytest.mark.parametrize("constant", [0.0, 0.5])
def test_for_actions_of_the_expected_scale_the_best_network_is_zero_and_its_loss_is_one(constant):
    """m = 0 and v = sigma_data make D = c_skip x; lambda var[action | x] and lambda c_out^2 are 1 at every sigma."""
    noise = NoiseLevels(sigma_data=0.7)
    action = 0.7 * torch.randn((16000, 3, 2), generator=seeded(0), dtype=torch.float64)
    output = torch.tensor(constant, dtype=torch.float64, requires_grad=True)
    loss = edm_loss(Denoiser(lambda x, t: output.expand_as(x), noise), action, samples=4, generator=seeded(1)).mean()
    (gradient,) = torch.autograd.grad(loss, output)
    assert loss.item() == pytest.approx(1 + constant**2, abs=0.02)
    assert gradient.item() == pytest.approx(2 * constant, abs=0.02)


def test_the_exact_denoiser_is_the_optimum_whatever_the_actions_scale():
    noise, p_mean, p_std = NoiseLevels(sigma_data=1.0), -0.8, 0.7
    offset = torch.zeros((), dtype=torch.float64, requires_grad=True)
    slope = torch.zeros((), dtype=torch.float64, requires_grad=True)
    exact = Exact(noise=noise)

    def network(scaled: Tensor, t: Tensor) -> Tensor:
        sigma = (math.log(80) - t * math.log(80 / 0.002)).exp()
        total = (sigma**2 + 1).sqrt()[:, None, None]
        x, s = scaled * total, sigma[:, None, None]
        best = (exact(x, sigma) - x / total**2) / (s / total)
        return best + offset + slope * scaled

    loss = edm_loss(Denoiser(network, noise), chunks(20_000), p_mean=p_mean, p_std=p_std, generator=seeded(1)).mean()
    nodes = torch.linspace(-8, 8, 4001, dtype=torch.float64)
    density = (-(nodes**2) / 2).exp()
    sigma = (p_mean + p_std * nodes).exp()
    weight = 1 / sigma**2 + 1
    expected = (density * weight * STD**2 * sigma**2 / (STD**2 + sigma**2)).sum() / density.sum()
    assert loss.item() == pytest.approx(expected.item(), rel=0.02)
    assert max(abs(g.item()) for g in torch.autograd.grad(loss, [offset, slope])) < 0.01


def test_padding_does_not_count_and_a_chunks_draws_are_its_own():
    given = []
    denoiser = Denoiser(lambda x, t: given.append(t) or torch.zeros_like(x), NoiseLevels())
    action = chunks(3)
    mask = torch.tensor([[True, True, False], [True] * 3, [False] * 3])
    loss = edm_loss(denoiser, action, mask=mask, samples=5, generator=seeded(2))
    assert loss.shape == (3,) and loss[2] == 0 and (loss[:2] > 0).all()
    assert given[0].shape == (15,) and len(given[0].unique()) == 15
    action[~mask] = 1e6
    assert torch.equal(edm_loss(denoiser, action, mask=mask, samples=5, generator=seeded(2)), loss)
    action[1] += 1  # the second chunk's draws are in the second row
    moved = edm_loss(denoiser, action, mask=mask, samples=5, generator=seeded(2)) != loss
    assert moved.tolist() == [False, True, False]


# --- The ODE ---


def test_a_step_towards_a_single_point_is_exact():
    """Without spread, D = m, the paths are straight lines: x - m is proportional to sigma."""
    x, now, then = chunks(2), torch.tensor([8.0, 0.5]).double(), torch.tensor([5.0, 0.02]).double()
    arrived = heun(lambda x, sigma: torch.full_like(x, MEAN), x, now, then)
    torch.testing.assert_close(arrived, MEAN + (x - MEAN) * (then / now)[:, None, None])


def test_heun_steps_follow_the_ode_to_second_order():
    x, errors = chunks(4), []
    start = torch.full((4,), 5.0, dtype=torch.float64)
    for steps in (20, 40, 80):
        sigmas = torch.linspace(5.0, 0.3, steps + 1, dtype=torch.float64)
        exact = flowed(x, start, torch.full_like(start, 0.3))
        errors.append((solve(Exact(), x, sigmas) - exact).abs().max().item())
    assert errors[0] < 1e-2
    assert all(3.5 < coarse / fine < 5 for coarse, fine in pairwise(errors))


def test_the_grid_leads_from_noise_to_the_actions():
    grid = NoiseLevels().grid(like=DOUBLE)
    x = 80 * torch.randn((2000, 3, 2), generator=seeded(3), dtype=torch.float64)
    exact, teacher = flowed(x, grid[:1], grid[-1:]), Exact()
    sample = solve(teacher, x, grid)
    torch.testing.assert_close(sample, exact, rtol=0, atol=0.02 * STD)
    assert sample.mean() == pytest.approx(MEAN, abs=0.01) and sample.std() == pytest.approx(STD, abs=0.01)
    assert len(teacher.asked) == 2 * 79


# --- Distillation ---


def test_the_exact_consistency_function_loses_nothing_and_any_other_what_it_is_off_by():
    exact, action = Exact(lowest=0.002), chunks(500)
    best = distillation_loss(exact, exact, Exact(), action, generator=seeded(0))
    assert best.max() < 1e-6
    loss = distillation_loss(Exact(lowest=0.002, offset=0.3), exact, Exact(), action, generator=seeded(0))
    torch.testing.assert_close(loss, torch.full_like(loss, 0.09), rtol=1e-2, atol=0)


def test_every_pair_of_adjacent_levels_is_drawn():
    noise = NoiseLevels(levels=6)
    student, target, teacher = Exact(0.002, noise), Exact(0.002, noise), Exact(noise=noise)
    distillation_loss(student, target, teacher, chunks(400), samples=3, generator=seeded(0))
    grid = noise.grid(like=DOUBLE)
    (now,), (then,) = student.asked, target.asked
    assert now.shape == (1200,)
    level = (now[:, None] == grid).float().argmax(dim=1)
    assert torch.equal(grid[level], now) and torch.equal(grid[level + 1], then)
    counts = level.bincount(minlength=6)
    assert counts[5] == 0 and counts[:5].min() > 190  # 240 each, give or take
    assert torch.equal(teacher.asked[0], now) and torch.equal(teacher.asked[1], then)


class Scaled(nn.Module):
    """A small network F of x and the time, both scalars of an action."""

    def __init__(self, width: int = 48):
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(2, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, 1)
        )

    def forward(self, x: Tensor, t: Tensor) -> Tensor:
        return self.layers(torch.cat([x, t[:, None, None].expand_as(x)], dim=-1))


def test_a_student_comes_to_leap_where_its_teacher_walks():
    torch.manual_seed(0)
    noise = NoiseLevels(levels=20, sigma_max=20.0)
    network = Scaled()
    averaged = copy.deepcopy(network)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 1500)
    student, target = (Denoiser(n, noise, identity=0.002) for n in (network, averaged))
    for _ in range(1500):
        action = MEAN + STD * torch.randn(256, 1, 1)
        loss = distillation_loss(student, target, Exact(noise=noise), action).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        with torch.no_grad():
            torch._foreach_lerp_(list(averaged.parameters()), list(network.parameters()), 0.1)
    assert all(parameter.grad is None for parameter in averaged.parameters())
    grid = noise.grid(like=torch.zeros(()))
    for level in reversed(range(20)):
        sigma = grid[level].expand(500)
        x = MEAN + (STD**2 + grid[level] ** 2).sqrt() * torch.randn(500, 1, 1)
        with torch.no_grad():
            error = (student(x, sigma) - flowed(x, sigma, torch.full_like(sigma, 0.002))).square().mean().sqrt()
        assert error < 0.25 * STD, level  # Heun steps between so few levels make 0.03 of it
    # A denoiser would answer with the mean of the actions here, off by their whole spread.
    with torch.no_grad():
        leap, mean = (function(x, grid[:1].expand(500)) for function in (student, Exact()))
    assert mean.std() < 0.05 * STD and leap.std() == pytest.approx(STD, rel=0.2)


# --- The editor ---


@pytest.mark.parametrize("level", [0, 10, 40, 60, 79])
@pytest.mark.parametrize("blend", [0.0, 0.3])
def test_an_edit_is_one_leap_from_the_levels_sigma_without_noise(level, blend):
    student, proposal = Exact(lowest=0.002), chunks(4, seed=5)
    edited = CSA(level=level, blend=blend)(proposal, Reference(student))
    (asked,) = student.asked
    step = (0.002 ** (1 / 7) - 80 ** (1 / 7)) / 79
    sigma = (80 ** (1 / 7) + level * step) ** 7
    shrink = math.sqrt((STD**2 + 0.002**2) / (STD**2 + sigma**2))
    torch.testing.assert_close(asked, torch.full((4,), sigma, dtype=torch.float64))
    torch.testing.assert_close(edited, blend * proposal + (1 - blend) * (MEAN + shrink * (proposal - MEAN)))


def test_a_blend_of_one_keeps_the_proposal_even_of_a_broken_student():
    student = Denoiser(lambda x, t: torch.full_like(x, torch.nan), NoiseLevels())
    proposal = chunks(4)
    assert torch.equal(CSA(blend=1.0)(proposal, Reference(student)), proposal)
    assert CSA(blend=0.99)(proposal, Reference(student)).isnan().all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": -1}, "CSA: level is -1, but must not be negative"),
        ({"blend": 1.1}, "CSA: blend is 1.1, but must lie in"),
        ({"blend": -0.1}, "CSA: blend is -0.1, but must lie in"),
        ({"blend": math.nan}, "CSA: blend is nan, but must lie in"),
        ({"level": 80}, "CSA: level is 80, but the student's levels are 0 to 79"),
    ],
)
def test_impossible_settings_are_one_clear_line(options, message):
    with pytest.raises(ValueError, match=message):
        CSA(**options)(chunks(2), Reference(Exact(lowest=0.002)))
