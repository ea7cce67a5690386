"""Smooth noise against the closed form of an AR(1) process."""

import math

import pytest
import torch

from lerobot_gloves.perturbations import Smooth
from tests.perturbations.chunks import emitted

EPISODES = 4000


def noise(sigma: float, tau: float, lengths: tuple[int, ...] = (10, 10, 10)) -> torch.Tensor:
    """Of many episodes, (B, steps, 2), over the borders of chunks."""
    given = [torch.zeros(EPISODES, length, 2, dtype=torch.float64) for length in lengths]
    return torch.cat(emitted(Smooth(sigma=sigma, tau=tau), given), dim=1)


def test_it_has_its_variance_at_every_step():
    """Also at the first one: a process that began at zero would still be growing."""
    drawn = noise(sigma=0.3, tau=6.0)
    error = 4.5 * 0.3 / math.sqrt(2 * EPISODES)
    assert (drawn.std(dim=0) - 0.3).abs().max() < error
    assert drawn.mean(dim=0).abs().max() < 4.5 * 0.3 / math.sqrt(EPISODES)


@pytest.mark.parametrize("tau", [2.0, 20.0])
def test_its_correlation_falls_exponentially_across_chunks_as_inside(tau):
    drawn = noise(sigma=1.0, tau=tau, lengths=(7, 16, 7))
    found = torch.corrcoef(drawn[..., 0].T)
    steps = torch.arange(30, dtype=torch.float64)
    expected = torch.exp(-(steps[:, None] - steps).abs() / tau)
    assert (found - expected).abs().max() < 4.5 / math.sqrt(EPISODES)


def test_dimensions_and_episodes_drift_apart():
    drawn = noise(sigma=1.0, tau=20.0)
    assert abs(torch.corrcoef(drawn[:, 15].T)[0, 1]) < 4 / math.sqrt(EPISODES)
    neighbours = torch.stack([drawn[:-1, 15, 0], drawn[1:, 15, 0]])
    assert abs(torch.corrcoef(neighbours)[0, 1]) < 4 / math.sqrt(EPISODES)


def test_a_new_episode_does_not_go_on_from_the_last():
    """At a correlation time this long, noise that went on would be all but the same."""
    perturbation, given = Smooth(sigma=1.0, tau=1e6), [torch.zeros(EPISODES, 10, 2)]
    (before,), (after,) = (emitted(perturbation, given, first_episode=first) for first in (0, EPISODES))
    assert abs(torch.corrcoef(torch.stack([before[:, -1, 0], after[:, 0, 0]]))[0, 1]) < 4 / math.sqrt(EPISODES)


def test_a_drift_goes_on_from_the_actions_that_ran():
    """All that is executed is one AR(1) process: correlation rho over the borders of chunks that were cut off, too."""
    rho, ran = math.exp(-1 / 5), 4
    perturbation = Smooth(sigma=1.0, tau=5.0)
    perturbation.reset(4000, seed=0)
    zeros = torch.zeros(4000, 10, 1)
    noise = torch.cat([perturbation(zeros, ran if i else None)[:, :ran] for i in range(3)], dim=1)[..., 0]
    for step in (ran - 1, ran, 2 * ran - 1):
        found = torch.corrcoef(torch.stack([noise[:, step], noise[:, step + 1]]))[0, 1].item()
        assert abs(found - rho) < 4 / math.sqrt(4000)
