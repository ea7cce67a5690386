"""Noise on every action: white, or smooth over the episode."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import randn
from lerobot_gloves.perturbations.base import Perturbation, check_not_negative, check_positive


@dataclass
class Noised(Perturbation):
    """Gaussian noise on every action: imprecise, jittery control."""

    # Standard deviation, in raw action units.
    sigma: float = 0.005

    def __post_init__(self) -> None:
        check_not_negative("Noised", "sigma", self.sigma)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        return chunk + self.sigma * randn(chunk.shape, self._generators(chunk), like=chunk)


@dataclass
class Smooth(Perturbation):
    """Gaussian noise that drifts slowly: a bias that wanders over the episode, chunk borders included.

    An Ornstein-Uhlenbeck process at the actions' steps, AR(1), for each dimension: n_0 = sigma e_0, then
    n_t = rho n_{t-1} + sigma sqrt(1 - rho^2) e_t with rho = exp(-1 / tau) and white e of variance 1, so that n has
    variance sigma^2 at every step and correlation rho^k over k steps.
    """

    # Standard deviation, in raw action units.
    sigma: float = 0.003
    # Correlation time, in steps: after so many, the correlation has fallen to 1/e.
    tau: float = 10.0

    def __post_init__(self) -> None:
        check_not_negative("Smooth", "sigma", self.sigma)
        check_positive("Smooth", "tau", self.tau)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        white = randn(chunk.shape, self._generators(chunk), like=chunk)
        rho = math.exp(-1.0 / self.tau)
        noise, noises = self._state(ran), []
        before = noise
        for drawn in white.unbind(dim=1):
            noise = drawn if noise is None else rho * noise + math.sqrt(1.0 - rho**2) * drawn
            noises.append(noise)
        self._states = [before, *noises]
        return chunk + self.sigma * torch.stack(noises, dim=1)
