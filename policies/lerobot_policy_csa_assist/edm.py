"""Karras' diffusion: noise levels, preconditioned denoiser, training loss and Heun step (Karras et al. 2022, "EDM").

A noisy chunk is x = action + sigma * noise, sigma from `sigma_max` (nothing of the action is left) down to `sigma_min`.
The probability-flow ODE dx / dsigma = (x - D(x, sigma)) / sigma carries the distributions of all levels into one
another, D(x, sigma) being the mean of the action behind x.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, mean_per_chunk
from lerobot_gloves.generators import randn


@dataclass(frozen=True)
class NoiseLevels:
    """The range of sigma, its grid and the scale of the data, all in normalised action units.

    Attributes:
        sigma_min: Smallest sigma, taken for no noise.
        sigma_max: Largest sigma.
        rho: Exponent of the grid: the larger, the closer its levels lie at small sigma.
        levels: Number of levels.
        sigma_data: Standard deviation of the actions.
    """

    sigma_min: float = 0.002
    sigma_max: float = 80.0
    rho: float = 7.0
    levels: int = 80
    sigma_data: float = 1.0

    def grid(self, like: Tensor, levels: int | None = None) -> Tensor:
        """Karras' grid from `sigma_max` down to `sigma_min` (EDM, equation 5): shape (levels,), dtype of `like`.

        Level i is (sigma_max^(1/rho) + i / (levels - 1) (sigma_min^(1/rho) - sigma_max^(1/rho)))^rho.

        Args:
            like: Gives dtype and device.
            levels: Another number of levels.
        """
        # On the CPU, since not every device has double precision.
        ramp = torch.linspace(0, 1, levels or self.levels, dtype=torch.float64)
        top, bottom = self.sigma_max ** (1 / self.rho), self.sigma_min ** (1 / self.rho)
        return ((top + ramp * (bottom - top)) ** self.rho).to(like.dtype).to(like.device)

    def time(self, sigma: Tensor) -> Tensor:
        """What the network is told of sigma: 0 at `sigma_max`, 1 at `sigma_min`, linear in log sigma.

        EDM's c_noise = log(sigma) / 4 is as good as any other linear function of log sigma. This one fills the range
        that the DiT's time embedding is made for, [0, 1] from noise to action, as for a flow: adjacent levels of the
        default grid lie at least 0.0065 apart, 6.5 radians of its fastest sinusoid.
        """
        return (math.log(self.sigma_max) - sigma.log()) / math.log(self.sigma_max / self.sigma_min)


@dataclass(frozen=True)
class Denoiser:
    """A network F between scalings, D(x, sigma) = c_skip x + c_out F(c_in x, time(sigma)) (EDM, equation 7).

    The scalings give F inputs and targets of unit variance. They make D the identity where sigma is `identity`:
    at 0 for a diffusion model; at sigma_min for a consistency function, whose boundary condition that is (Song et al.
    2023, appendix C).

    Attributes:
        network: F, any callable (x, t) -> (N, T, A), its context bound.
        noise: Noise levels and sigma_data.
        identity: The sigma at which D(x, sigma) = x.
    """

    network: VelocityField
    noise: NoiseLevels
    identity: float = 0.0

    def __call__(self, x: Tensor, sigma: Tensor) -> Tensor:
        """Denoised chunks (N, T, A) of noisy ones (N, T, A) at sigma (N,)."""
        data, beyond = self.noise.sigma_data, (sigma - self.identity)[:, None, None]
        total = (sigma**2 + data**2).sqrt()[:, None, None]
        skip, out = data**2 / (beyond**2 + data**2), data * beyond / total
        return skip * x + out * self.network(x / total, self.noise.time(sigma))


def heun(denoiser: Denoiser, x: Tensor, now: Tensor, then: Tensor) -> Tensor:
    """One second-order step along the probability-flow ODE.

    Args:
        denoiser: D.
        x: Noisy chunks at sigma `now`, shape (N, T, A).
        now: Sigmas to begin at, shape (N,), above 0.
        then: Sigmas to arrive at, shape (N,), above 0.

    Returns:
        Chunks at sigma `then`, shape (N, T, A).
    """
    step = (then - now)[:, None, None]
    slope = (x - denoiser(x, now)) / now[:, None, None]
    ahead = x + step * slope
    return x + step * (slope + (ahead - denoiser(ahead, then)) / then[:, None, None]) / 2


def solve(denoiser: Denoiser, x: Tensor, sigmas: Iterable[Tensor]) -> Tensor:
    """Heun steps along `sigmas`, scalars, from chunks x (N, T, A) at the first to chunks at the last."""
    for now, then in pairwise(sigmas):
        x = heun(denoiser, x, now.expand(len(x)), then.expand(len(x)))
    return x


def edm_loss(
    denoiser: Denoiser,
    action: Tensor,
    *,
    p_mean: float = -0.5,
    p_std: float = 1.2,
    mask: Tensor | None = None,
    samples: int = 1,
    generator: torch.Generator | None = None,
) -> Tensor:
    """E lambda(sigma) ||D(action + sigma noise, sigma) - action||^2, mean per action, of every chunk (EDM, section 5).

    log sigma is normal, and lambda = 1 / sigma^2 + 1 / sigma_data^2 makes F's error count alike at every sigma.

    Args:
        denoiser: D, bound to the B contexts of `action`.
        action: Expert chunks, shape (B, T, A).
        p_mean: Mean of log sigma; Karras has -1.2 for a sigma_data of 0.5, which at 1 is -1.2 + log 2.
        p_std: Standard deviation of log sigma.
        mask: True where an action counts, shape (B, T); None: all count.
        samples: Independent draws of noise and of sigma per chunk.
        generator: Source of the draws.

    Returns:
        Loss per chunk, shape (B,); 0 for a chunk that is all padding.
    """
    clean = action.repeat_interleave(samples, dim=0)
    sigma = (p_mean + p_std * randn(clean.shape[:1], generator, like=clean)).exp()
    noisy = clean + sigma[:, None, None] * randn(clean.shape, generator, like=clean)
    weight = 1 / sigma**2 + 1 / denoiser.noise.sigma_data**2
    error = weight[:, None, None] * (denoiser(noisy, sigma) - clean).square()
    return mean_per_chunk(error, samples, mask)
