"""Negative log-likelihood of a chunk under the expert flow, by its probability-flow ODE."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, integrate


@dataclass(frozen=True)
class LikelihoodScore:
    """How improbable the flow finds the chunk, s(x) = -log p(x) in nats; negative where the density is above 1.

    Not in the paper. -log p(x) = -log N(z_hat; 0, 1) + int_0^1 div v(x_t, t) dt along the trajectory that ends in x,
    which backward Euler steps follow to its noise z_hat. The divergence is exact, or Hutchinson's estimate e' J e by
    Rademacher probes e; these are the same for every chunk, so that the score is a function of the chunk.

    Attributes:
        steps: Backward Euler steps from t = 1 to t = 0, one evaluation of the flow each.
        probes: Probes of the divergence, one backward pass each at every step. 0: the exact divergence, at one backward
            pass for each of the T A numbers of a chunk.
        seed: Seed of the probes.

    Raises:
        ValueError: If `steps` is below 1 or `probes` is negative.
    """

    steps: int = 10
    probes: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"LikelihoodScore: steps is {self.steps}, but must be at least 1")
        if self.probes < 0:
            raise ValueError(f"LikelihoodScore: probes is {self.probes}, but must not be negative")

    def __call__(self, velocity: VelocityField, chunk: Tensor, length: int | None = None) -> Tensor:
        """Score chunks; also within `torch.inference_mode()`, if what the flow holds was made outside it.

        Args:
            velocity: The expert flow, context bound, which must be differentiable in its first argument.
            chunk: Normalised chunks, shape (N, T, A).
            length: How many leading actions count. The rest is padding that the flow sees, but both norm and divergence
                leave out: exactly the density of the leading actions where the flow's actions are independent.

        Returns:
            Scores, shape (N,), in nats: low where the expert would act like this, high where it would not.
        """
        divergence = []

        def traced(x: Tensor, t: Tensor) -> Tensor:
            x = x.detach().requires_grad_()
            v = velocity(x, t)
            divergence.append(self._divergence(v, x, length))
            return v.detach()

        # LeRobot evaluates under inference mode, see `lerobot_gloves.editors.feeg`.
        with torch.inference_mode(False), torch.enable_grad(), torch.autocast(chunk.device.type, enabled=False):
            z = integrate(traced, chunk.detach().clone(), start=1.0, end=0.0, steps=self.steps)[:, :length]
            prior = 0.5 * (z.square() + math.log(2 * math.pi)).sum(dim=(1, 2))
            return prior + torch.stack(divergence).mean(dim=0)

    def _divergence(self, v: Tensor, x: Tensor, length: int | None) -> Tensor:
        """Trace (N,) of the Jacobian of v in x, of the leading actions."""
        if not v.requires_grad:  # A field that does not depend on x.
            return x.new_zeros(x.shape[0])
        total = x.new_zeros(x.shape[0])
        for probe in self._probes(x, length):
            (pulled,) = torch.autograd.grad(v, x, probe.expand_as(x), retain_graph=True, allow_unused=True)
            if pulled is not None:
                total = total + (pulled * probe).sum(dim=(1, 2))
        return total / max(self.probes, 1)

    def _probes(self, x: Tensor, length: int | None) -> Iterator[Tensor]:
        """Probes (T, A), 0 where an action does not count; their mean (exact: their sum) of e' J e is the trace."""
        counted = torch.zeros_like(x[0])
        counted[:length] = 1
        if self.probes:
            generator = torch.Generator().manual_seed(self.seed)
            for _ in range(self.probes):
                sign = 2 * torch.randint(2, x.shape[1:], generator=generator) - 1
                yield sign.to(x) * counted
        else:
            yield from torch.diag(counted.flatten())[counted.flatten().bool()].view(-1, *x.shape[1:])
