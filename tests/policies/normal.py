"""What is known of diffusion where actions are normally distributed.

Let the actions be N(m, v^2), one coordinate at a time. A noisy action x at sigma is N(m, v^2 + sigma^2), and

    D(x, sigma) = E[action | x] = m + v^2 / (v^2 + sigma^2) (x - m),   var[action | x] = v^2 sigma^2 / (v^2 + sigma^2).

The probability-flow ODE, dx / dsigma = (x - D) / sigma = (x - m) sigma / (v^2 + sigma^2), is solved by

    x(sigma) = m + (x_0 - m) sqrt((v^2 + sigma^2) / (v^2 + sigma_0^2)).
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from lerobot_policy_csa_assist.edm import NoiseLevels
from tests.gaussian import seeded

NOISE = NoiseLevels()
DOUBLE = torch.zeros((), dtype=torch.float64)
MEAN, STD = 0.6, 0.4


@dataclass
class Exact:
    """D, or the consistency function that leads to `lowest`, of N(MEAN, STD^2); it counts what it is asked."""

    lowest: float | None = None
    noise: NoiseLevels = NOISE
    offset: float = 0.0
    asked: list[Tensor] = field(default_factory=list)

    def __call__(self, x: Tensor, sigma: Tensor) -> Tensor:
        self.asked.append(sigma)
        if self.lowest is not None:
            return flowed(x, sigma, torch.full_like(sigma, self.lowest)) + self.offset
        return MEAN + (STD**2 / (STD**2 + sigma**2))[:, None, None] * (x - MEAN)


def flowed(x: Tensor, now: Tensor, then: Tensor) -> Tensor:
    """Where the ODE takes x (N, T, A) from sigmas `now` to `then`, (N,)."""
    return MEAN + (x - MEAN) * ((STD**2 + then**2) / (STD**2 + now**2)).sqrt()[:, None, None]


def chunks(number: int, seed: int = 0) -> Tensor:
    """Actions of N(MEAN, STD^2), (number, 3, 2)."""
    return MEAN + STD * torch.randn((number, 3, 2), generator=seeded(seed), dtype=torch.float64)
