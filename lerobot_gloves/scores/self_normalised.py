"""Self-normalised score: a chunk's residual among those of the flow's own chunks for the same context."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, integrate
from lerobot_gloves.generators import randn
from lerobot_gloves.scores.residual import ResidualScore


@dataclass(frozen=True)
class SelfNormalisedScore:
    """How many standard deviations a chunk's residual lies above those of samples; negative below their mean.

    Not in the paper. s(x) = (r(x) - mean_i r(x_i)) / max(std_i r(x_i), floor * mean_i r(x_i)), r being `ResidualScore`
    and x_i samples of the flow in the context of x. Where the expert is precise and where it is loose, its chunks score
    alike, so one threshold serves both. Residuals, since they are low in the modes alone: a distance from the samples'
    mean, as the noise that the reverse score measures, is least between two modes. All that is drawn is the same for
    every chunk.

    Attributes:
        samples: Samples n a chunk.
        steps: Euler steps of each sample, at t = 1 - (1 - k / steps)^2: equal ones are too long near t = 1, where they
            draw a narrow expert's samples together.
        times: Times of the residual. The flow is evaluated `samples` `steps` + 2 (`samples` + 1) `times` times a chunk.
        floor: Least standard deviation, as a share of the mean.
        seed: Seed of the noise.

    Raises:
        ValueError: If `samples` is below 2, `steps` or `times` below 1, or `floor` negative.
    """

    samples: int = 8
    steps: int = 5
    times: int = 3
    floor: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.samples < 2:
            raise ValueError(f"SelfNormalisedScore: samples is {self.samples}, but must be at least 2")
        if self.steps < 1 or self.times < 1:
            raise ValueError(f"SelfNormalisedScore: steps and times must be at least 1, got {self}")
        if not self.floor >= 0:
            raise ValueError(f"SelfNormalisedScore: floor is {self.floor}, but must not be negative")

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None) -> Tensor:
        """Score chunks.

        Args:
            velocity: The expert flow, context bound. It is called with several rows a chunk.
            chunk: Normalised chunks, shape (N, T, A).
            length: How many leading actions count, of the chunk, whose padding the flow sees, and of the samples.

        Returns:
            Scores, shape (N,): low where the expert would act like this, high where it would not.
        """
        number, n = chunk.shape[0], self.samples
        noise = randn((n, *chunk.shape[1:]), torch.Generator().manual_seed(self.seed), like=chunk)
        grid = [1 - (1 - k / self.steps) ** 2 for k in range(self.steps + 1)]
        samples = integrate(velocity, noise.repeat(number, 1, 1), grid=grid).unflatten(0, (number, n))
        # Another seed: the noise that a sample began as is not one to meet it by.
        residual = ResidualScore(times=self.times, seed=self.seed + 1)
        together = torch.cat([chunk[:, None], samples], dim=1).flatten(0, 1)
        own, others = residual(velocity, together, length=length).view(number, n + 1).split([1, n], dim=1)
        mean, std = others.mean(dim=1), others.std(dim=1)
        return (own[:, 0] - mean) / (torch.maximum(std, self.floor * mean) + torch.finfo(chunk.dtype).eps)
