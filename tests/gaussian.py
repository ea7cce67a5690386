"""Rectified flow of a Gaussian, written down exactly: what the tests compare the library with.

Let x_0 ~ N(0, 1) and x_1 ~ N(mu, s^2) be independent, one coordinate at a time. On the straight path,

    x_t = (1 - t) x_0 + t x_1 ~ N(t mu, w^2),        w^2 = (1 - t)^2 + t^2 s^2,
    cov(x_1 - x_0, x_t) = t s^2 - (1 - t).

(x_1 - x_0, x_t) is jointly normal, so the field that minimises the flow-matching loss, its conditional mean,
is

    v(x, t) = E[x_1 - x_0 | x_t = x] = mu + g (x - t mu),        g = (t s^2 - (1 - t)) / w^2,

and likewise the mean of the action behind x_t, whose derivative in x is j,

    E[x_1 | x_t = x] = mu + j (x - t mu),        j = t s^2 / w^2.

As w' = (t s^2 - (1 - t)) / w = g w, the trajectory from z is x_t = t mu + w z: the flow maps z to mu + s z.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass
class GaussianFlow:
    """Exact velocity field of N(mean, std^2), independent coordinates.

    Attributes:
        mean: mu, shape (T, A), or (B, T, A) for B contexts.
        std: s, same shape.
    """

    mean: Tensor
    std: Tensor

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        """v(x, t) for x (N, T, A) and t (N,); the rows of one context are adjacent."""
        mean, gain = self._rows(self.mean, x), self.gain(t, x)
        return mean + gain * (x - t[:, None, None] * mean)

    def gain(self, t: Tensor, x: Tensor) -> Tensor:
        """g, the derivative of the velocity in x."""
        t = t[:, None, None]
        variance = self._rows(self.std, x) ** 2
        return (t * variance - (1 - t)) / ((1 - t) ** 2 + t**2 * variance)

    def posterior_mean(self, x: Tensor, t: Tensor) -> Tensor:
        """E[x_1 | x_t = x]."""
        mean = self._rows(self.mean, x)
        return mean + self.jacobian(t, x) * (x - t[:, None, None] * mean)

    def jacobian(self, t: Tensor, x: Tensor) -> Tensor:
        """j, the derivative of the posterior mean in x."""
        t = t[:, None, None]
        variance = self._rows(self.std, x) ** 2
        return t * variance / ((1 - t) ** 2 + t**2 * variance)

    def position(self, z: Tensor, t: float) -> Tensor:
        """Point at time t of the trajectory that begins at z."""
        width = ((1 - t) ** 2 + t**2 * self._rows(self.std, z) ** 2).sqrt()
        return t * self._rows(self.mean, z) + width * z

    def sample(self, number: int, generator: torch.Generator) -> Tensor:
        """Exact chunks of the one context, shape (number, T, A)."""
        noise = torch.randn((number, *self.mean.shape), generator=generator, dtype=self.mean.dtype)
        return self.mean + self.std * noise

    @staticmethod
    def _rows(parameter: Tensor, x: Tensor) -> Tensor:
        if parameter.dim() == 2:
            return parameter
        return parameter.repeat_interleave(x.shape[0] // parameter.shape[0], dim=0)


def example_flow(contexts: int | None = None) -> GaussianFlow:
    """A flow on chunks (3, 2) in double precision: narrow and wide coordinates, means away from 0."""
    shape = (3, 2) if contexts is None else (contexts, 3, 2)
    number = torch.Size(shape).numel()
    mean = torch.linspace(-1.5, 1.2, number, dtype=torch.float64).view(shape)
    std = torch.logspace(-1, 0.3, number, dtype=torch.float64).flip(0).view(shape)
    return GaussianFlow(mean, std)


def seeded(seed: int) -> torch.Generator:
    """A generator on the CPU."""
    return torch.Generator().manual_seed(seed)


@dataclass
class MixtureFlow:
    """Exact velocity field of a mixture of Gaussians, equally likely.

    x_t is a mixture too, of the components' own x_t, and the field the mean of theirs, weighted by how likely each is
    given x_t.

    Attributes:
        modes: The components, each of one context.
    """

    modes: list[GaussianFlow]

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        """v(x, t) for x (N, T, A) and t (N,)."""
        widths = [((1 - t) ** 2)[:, None, None] + (t**2)[:, None, None] * mode.std**2 for mode in self.modes]
        centres = [t[:, None, None] * mode.mean for mode in self.modes]
        log = [
            -((x - centre) ** 2 / width + width.log()).sum((1, 2)) / 2
            for centre, width in zip(centres, widths, strict=True)
        ]
        share = torch.softmax(torch.stack(log), dim=0)[..., None, None]
        return (share * torch.stack([mode(x, t) for mode in self.modes])).sum(0)

    def log_density(self, x: Tensor) -> Tensor:
        """log p(x) of chunks (N, T, A): (N,)."""
        log = [torch.distributions.Normal(mode.mean, mode.std).log_prob(x).sum((1, 2)) for mode in self.modes]
        return torch.stack(log).logsumexp(0) - math.log(len(self.modes))

    def sample(self, number: int, generator: torch.Generator) -> Tensor:
        """Exact chunks, shape (number, T, A)."""
        drawn = torch.stack([mode.sample(number, generator) for mode in self.modes])
        return drawn[torch.randint(len(self.modes), (number,), generator=generator), torch.arange(number)]


def two_modes(std: float, distance: float = 1.0) -> MixtureFlow:
    """Chunks (3, 2) about `distance` and about minus that, `std` around either, in double precision."""
    mean, spread = (torch.full((3, 2), value, dtype=torch.float64) for value in (distance, std))
    return MixtureFlow([GaussianFlow(mean, spread), GaussianFlow(-mean, spread)])
