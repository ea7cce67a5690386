"""Flow-matching residual: how badly a chunk fits the field along straight paths that lead to it."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, interpolate
from lerobot_gloves.generators import randn


@dataclass(frozen=True)
class ResidualScore:
    """The flow-matching loss of the chunk, s(x) = E_{t, z} ||v((1 - t) z + t x, t) - (x - z)||^2.

    Not in the paper. On the flow of a Gaussian of standard deviation s the residual at t is, a coordinate at distance d
    from the mean, ((1 - t)^2 d^2 + t^2 s^4) / w^4 with w^2 = (1 - t)^2 + t^2 s^2: it grows with d at every t, the most
    about 1 - t = t s, so that times from all over (0, 1) serve narrow and wide experts. Times and noise are those of
    every chunk (common random numbers), and the noise comes in pairs z, -z, which cancel what is linear in it: on that
    flow all chunks of an equal distance score alike, whatever was drawn.

    Attributes:
        times: How many times, the midpoints of as many equal parts of [0, 1].
        pairs: Pairs of noise at each time. An evaluation of the flow for each time and noise: 2 `times` `pairs`.
        seed: Seed of the noise.

    Raises:
        ValueError: If `times` or `pairs` is below 1.
    """

    times: int = 5
    pairs: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.times < 1 or self.pairs < 1:
            raise ValueError(f"ResidualScore: times and pairs must be at least 1, got {self}")

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None) -> Tensor:
        """Score chunks.

        Args:
            velocity: The expert flow, context bound. It is called once, with 2 `times` `pairs` rows a chunk.
            chunk: Normalised chunks, shape (N, T, A).
            length: How many leading actions count; the rest is padding that the flow sees but the norm leaves out.

        Returns:
            Scores, shape (N,): low where the expert would act like this, high where it would not.
        """
        number, drawn = chunk.shape[0], self.times * self.pairs
        noise = randn((drawn, *chunk.shape[1:]), torch.Generator().manual_seed(self.seed), like=chunk)
        noise = torch.cat([noise, -noise]).repeat(number, 1, 1)
        midpoints = (torch.arange(self.times, dtype=chunk.dtype, device=chunk.device) + 0.5) / self.times
        t, action = midpoints.repeat(2 * self.pairs * number), chunk.repeat_interleave(2 * drawn, dim=0)
        residual = velocity(interpolate(noise, action, t), t) - (action - noise)
        return residual[:, :length].square().sum(dim=(1, 2)).view(number, -1).mean(dim=1)
