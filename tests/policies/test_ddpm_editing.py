"""The DDPM baseline's diffusion and editor on data whose best noise prediction can be written down.

Let actions be N(m, s^2), one coordinate at a time. Then x_k = sqrt(abar) action + sqrt(1 - abar) noise is normal with
variance w = abar s^2 + 1 - abar, (noise, x_k) is jointly normal with covariance sqrt(1 - abar), and the prediction that
minimises the loss is the conditional mean

    epsilon(x, k) = sqrt(1 - abar) (x - sqrt(abar) m) / w,      what is left of the noise having variance abar s^2 / w.

It is affine in x, so an ancestral step is too: x_{k-1} = A x_k + B + sqrt(beta) z with

    A = (1 - beta / w) / sqrt(1 - beta),      B = beta sqrt(abar) m / (w sqrt(1 - beta)),

and means and variances follow the recursion (mu, v) -> (A mu + B, A^2 v + beta).
"""

import math

import numpy as np
import pytest
import torch

from lerobot_gloves.editors import Reference
from lerobot_policy_ddpm_assist.configuration_ddpm_assist import SCHEDULES
from lerobot_policy_ddpm_assist.diffusion import Diffusion, noise_prediction_loss, noise_scheduler
from lerobot_policy_ddpm_assist.editor import DDPM
from tests.gaussian import seeded

N = 50
ALL_STEPS = range(N - 1, -1, -1)
MEAN = torch.tensor([[-1.5, 0.3], [0.0, 2.0], [-0.2, 1.0]], dtype=torch.float64)
STD = torch.tensor([[0.1, 0.5], [1.0, 2.0], [0.3, 0.8]], dtype=torch.float64)


def betas(schedule: str, steps: int = N) -> np.ndarray:
    """Written down anew, from 1e-4 to 0.26."""
    if schedule == "linear":
        return np.array([1e-4 + (0.26 - 1e-4) * k / (steps - 1) for k in range(steps)])
    if schedule == "sigmoid":
        return np.array([1e-4 + (0.26 - 1e-4) / (1 + math.exp(6 - 12 * k / (steps - 1))) for k in range(steps)])
    signal = [math.cos((k / steps + 0.008) / 1.008 * math.pi / 2) ** 2 for k in range(steps + 1)]  # Nichol, Dhariwal
    return np.array([min(1 - signal[k + 1] / signal[k], 0.999) for k in range(steps)])


def gaussian(schedule: str = "sigmoid", mean: torch.Tensor = MEAN, std: torch.Tensor = STD) -> Diffusion:
    """The best prediction of N(mean, std^2), told the time that a step has: 1 - (k + 1) / N."""
    abar = torch.tensor(np.cumprod(1 - betas(schedule)))

    def network(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        a = abar[(N * (1 - t)).round().long() - 1][:, None, None].to(x)
        return (1 - a).sqrt() * (x - a.sqrt() * mean) / (a * std**2 + 1 - a)

    return Diffusion(network, noise_scheduler(schedule, N, 1e-4, 0.26))


def moments(schedule: str, mean: float, std: float, mu: float, v: float, first: int, last: int) -> tuple[float, float]:
    """Mean and variance after the ancestral steps from `first` down to `last`, of x with mean `mu`, variance `v`."""
    beta = betas(schedule)
    abar = np.cumprod(1 - beta)
    for k in range(first, last - 1, -1):
        w = abar[k] * std**2 + 1 - abar[k]
        slope = (1 - beta[k] / w) / math.sqrt(1 - beta[k])
        mu = slope * mu + beta[k] * math.sqrt(abar[k]) * mean / (w * math.sqrt(1 - beta[k]))
        v = slope**2 * v + (beta[k] if k > 0 else 0.0)
    return mu, v


def check_moments(samples: torch.Tensor, expected: list[tuple[float, float]]) -> None:
    """Within four standard errors, coordinate by coordinate."""
    number = len(samples)
    for column, (mean, variance) in zip(samples.flatten(1).unbind(1), expected, strict=True):
        assert abs(column.mean().item() - mean) < 4 * math.sqrt(variance / number)
        assert abs(column.var().item() - variance) < 4 * variance * math.sqrt(2 / (number - 1))


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_noising_at_once_is_noising_step_by_step(schedule):
    diffusion = gaussian(schedule)
    np.testing.assert_allclose(diffusion.scheduler.betas.numpy(), betas(schedule), rtol=2e-5)
    signal, variance = 1.0, 0.0
    for k, beta in enumerate(betas(schedule)):
        # q(x_k | x_{k-1}) = N(sqrt(1 - beta) x_{k-1}, beta)
        signal, variance = math.sqrt(1 - beta) * signal, (1 - beta) * variance + beta
        one, zero = torch.ones(1, 1, 1, dtype=torch.float64), torch.zeros(1, 1, 1, dtype=torch.float64)
        assert diffusion.noised(one, zero, torch.tensor([k])).item() == pytest.approx(signal, rel=2e-4)
        assert diffusion.noised(zero, one, torch.tensor([k])).item() == pytest.approx(math.sqrt(variance), rel=2e-4)


def test_every_row_has_a_step_of_its_own():
    diffusion, x = gaussian(), torch.randn(3, 3, 2, generator=seeded(0))
    together = diffusion.noised(x, -x, torch.tensor([0, 20, 49]))
    alone = [diffusion.noised(x[i : i + 1], -x[i : i + 1], torch.tensor([k])) for i, k in enumerate([0, 20, 49])]
    assert torch.equal(together, torch.cat(alone))


def test_the_originals_signal_and_noise_at_its_gammas():
    scheduler = noise_scheduler("sigmoid", N, 1e-4, 0.26)
    signal = {gamma: scheduler.alphas_cumprod[int(49 * gamma)].sqrt().item() for gamma in (0.2, 0.4, 0.5, 0.6)}
    assert signal == pytest.approx({0.2: 0.987, 0.4: 0.871, 0.5: 0.683, 0.6: 0.431}, abs=6e-4)
    assert scheduler.alphas_cumprod[-1].item() == pytest.approx(6.5e-4, rel=0.01)


def by_hand(schedule: str, x: np.ndarray, noise: list[np.ndarray], steps: range) -> np.ndarray:
    beta = betas(schedule)
    abar = np.cumprod(1 - beta)
    for k, z in zip(steps, noise, strict=True):
        epsilon = math.sqrt(1 - abar[k]) * (x - math.sqrt(abar[k]) * MEAN.numpy())
        epsilon = epsilon / (abar[k] * STD.numpy() ** 2 + 1 - abar[k])
        x = (x - beta[k] / math.sqrt(1 - abar[k]) * epsilon) / math.sqrt(1 - beta[k]) + math.sqrt(beta[k]) * z
    return x


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("gamma", [0.03, 0.2, 0.4, 0.7, 1.0])
def test_an_edit_is_the_recursion_by_hand(schedule, gamma):
    proposal = torch.randn(4, 3, 2, generator=seeded(0), dtype=torch.float64)
    edited = DDPM(gamma)(proposal, Reference(gaussian(schedule), generator=seeded(1)))
    k, source = int(49 * gamma), seeded(1)
    first, *noise = [torch.randn(4, 3, 2, generator=source, dtype=torch.float64).numpy() for _ in range(k + 1)]
    abar = np.cumprod(1 - betas(schedule))[k]
    noised = math.sqrt(abar) * proposal.numpy() + math.sqrt(1 - abar) * first
    expected = by_hand(schedule, noised, noise, range(k, 0, -1))
    # diffusers holds its betas in single precision.
    np.testing.assert_allclose(edited.numpy(), expected, rtol=0, atol=2e-4)


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_sampling_is_the_recursion_by_hand_and_ends_without_noise(schedule):
    noise, source = torch.randn(4, 3, 2, generator=seeded(0), dtype=torch.float64), seeded(1)
    sampled = gaussian(schedule).denoise(noise, ALL_STEPS, seeded(1))
    later = [torch.randn(4, 3, 2, generator=source, dtype=torch.float64).numpy() for _ in range(N - 1)]
    expected = by_hand(schedule, noise.numpy(), [*later, np.zeros(())], ALL_STEPS)
    np.testing.assert_allclose(sampled.numpy(), expected, rtol=0, atol=2e-4)


def test_samples_have_the_datas_mean_and_variance():
    noise = torch.randn(20_000, 3, 2, generator=seeded(0), dtype=torch.float64)
    sampled = gaussian().denoise(noise, ALL_STEPS, seeded(1))
    pairs = list(zip(MEAN.flatten().tolist(), STD.flatten().tolist(), strict=True))
    expected = [moments("sigmoid", m, s, 0.0, 1.0, N - 1, 0) for m, s in pairs]
    check_moments(sampled, expected)
    for (m, s), (mean, variance) in zip(pairs, expected, strict=True):  # fifty steps are nearly enough
        assert mean == pytest.approx(m, abs=6e-3) and math.sqrt(variance) == pytest.approx(s, rel=0.05)


@pytest.mark.parametrize("gamma", [0.2, 0.4, 0.6])
def test_an_edits_mean_is_affine_in_the_proposal_and_its_variance_is_not_moved_by_it(gamma):
    k = int(49 * gamma)
    abar = np.cumprod(1 - betas("sigmoid"))[k]
    for proposal in (MEAN, MEAN + 1.5):
        edited = DDPM(gamma)(proposal.expand(20_000, 3, 2), Reference(gaussian(), generator=seeded(2)))
        parameters = zip(MEAN.flatten().tolist(), STD.flatten().tolist(), proposal.flatten().tolist(), strict=True)
        check_moments(edited, [moments("sigmoid", m, s, math.sqrt(abar) * a, 1 - abar, k, 1) for m, s, a in parameters])


def test_the_nearer_to_the_noise_the_less_is_left_of_the_proposal():
    slopes = []
    for gamma in (0.0, 0.2, 0.4, 0.6, 1.0):
        edits = [DDPM(gamma)((MEAN + d)[None], Reference(gaussian(), generator=seeded(3))) for d in (0.0, 1.0)]
        slopes.append((edits[1] - edits[0]).flatten())
    assert (torch.stack(slopes).diff(dim=0) < 0).all()
    assert torch.allclose(slopes[0], torch.ones(6, dtype=torch.float64)) and slopes[-1].abs().max() < 0.1


@pytest.mark.parametrize(
    ("gamma", "steps"), [(0.0, 0), (0.02, 0), (0.03, 1), (0.2, 9), (0.4, 19), (0.5, 24), (1.0, 49)]
)
def test_an_edit_evaluates_the_network_once_a_step(gamma, steps):
    told = []
    diffusion = Diffusion(lambda x, t: told.append(t) or torch.zeros_like(x), gaussian().scheduler)
    DDPM(gamma)(torch.zeros(2, 3, 2, dtype=torch.float64), Reference(diffusion, generator=seeded(0)))
    expected = [[1 - (k + 1) / 50] * 2 for k in range(steps, 0, -1)]
    torch.testing.assert_close([t.tolist() for t in told], expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_without_noise_the_proposal_is_kept_even_by_a_broken_network(dtype):
    proposal = torch.randn(2, 3, 2, generator=seeded(0), dtype=dtype)
    broken = Diffusion(lambda x, t: torch.full_like(x, torch.nan), gaussian().scheduler)
    edited = DDPM(gamma=0)(proposal, Reference(broken, generator=seeded(0)))
    assert torch.equal(edited, proposal) and edited.dtype == dtype


@pytest.mark.parametrize("gamma", [-0.1, 1.1, math.nan])
def test_a_gamma_outside_its_range_is_refused(gamma):
    with pytest.raises(ValueError, match=rf"DDPM: gamma is {gamma}, but must lie in \[0, 1\]"):
        DDPM(gamma)


def test_an_environment_is_edited_alike_in_any_batch():
    proposal = torch.randn(4, 3, 2, generator=seeded(0), dtype=torch.float64)
    torch.manual_seed(0)
    state = torch.get_rng_state()
    edited = DDPM()(proposal, Reference(gaussian(), generator=[seeded(i) for i in range(4)]))
    alone = [DDPM()(proposal[i : i + 1], Reference(gaussian(), generator=[seeded(i)])) for i in range(4)]
    assert torch.equal(edited, torch.cat(alone))
    assert torch.equal(torch.get_rng_state(), state)
    same = DDPM()(proposal[:1].expand(2, 3, 2), Reference(gaussian(), generator=(seeded(0), seeded(1))))
    assert not torch.allclose(same[0], same[1], atol=1e-2)  # draws of its own


def test_the_loss_is_the_error_of_the_predicted_noise_over_several_draws():
    diffusion = Diffusion(lambda x, t: x * t[:, None, None], gaussian().scheduler)
    action = torch.randn(2, 3, 2, generator=seeded(0), dtype=torch.float64)
    mask = torch.tensor([[True, True, False], [False, False, False]])
    source, samples = seeded(1), 4
    noise = torch.randn(8, 3, 2, generator=source, dtype=torch.float64)
    step = torch.randint(50, (8,), generator=source)
    abar = torch.tensor(np.cumprod(1 - betas("sigmoid")))[step][:, None, None]
    x = abar.sqrt() * torch.stack([action[i // samples] for i in range(8)]) + (1 - abar).sqrt() * noise
    error = (x * (1 - (step + 1) / 50)[:, None, None] - noise) ** 2
    expected = torch.stack([error[:4].mean(), error[4:].mean()])
    loss = noise_prediction_loss(diffusion, action, samples=4, generator=seeded(1))
    torch.testing.assert_close(loss, expected, rtol=1e-5, atol=0)
    masked = noise_prediction_loss(diffusion, action, mask=mask, samples=4, generator=seeded(1))
    torch.testing.assert_close(masked, torch.stack([error[:4, :2].mean(), error.new_zeros(())]), rtol=1e-5, atol=0)


def test_the_best_predictions_loss_is_what_nobody_could_know():
    action = MEAN + STD * torch.randn(4_000, 3, 2, generator=seeded(0), dtype=torch.float64)
    abar = torch.tensor(np.cumprod(1 - betas("sigmoid")))[:, None, None]
    expected = (abar * STD**2 / (abar * STD**2 + 1 - abar)).mean()
    loss = noise_prediction_loss(gaussian(), action, samples=5, generator=seeded(1))
    assert loss.mean().item() == pytest.approx(expected.item(), abs=4 * loss.std().item() / math.sqrt(4_000))
    half = Diffusion(lambda x, t: 0.5 * gaussian().network(x, t), gaussian().scheduler)
    assert noise_prediction_loss(half, action, samples=5, generator=seeded(1)).mean() > 1.1 * expected
