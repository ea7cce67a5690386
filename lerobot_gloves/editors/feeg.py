"""FEEG: Flow Editing with Energy Guidance (paper, section "FEEG")."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.editors.reference import Reference
from lerobot_gloves.flow import VelocityField, endpoint, integrate, interpolate, times
from lerobot_gloves.generators import randn


@dataclass(frozen=True)
class FEEG:
    """Noise the proposal to time `start`, then follow the expert flow, pulled back towards the proposal.

    The guided velocity is v(x_t, t) - align * grad_{x_t} E(x_1_hat(x_t)), E(x_1) = ||x_1 - a_u||^2 / 2. The gradient
    is the exact vector-Jacobian product through the endpoint estimate, one backward pass a step.

    Attributes:
        start: Time t to begin at: 1 keeps the proposal, 0 resamples from the expert under guidance alone.
        steps: Euler steps from `start` to 1.
        align: Guidance strength, lambda_align.

    Raises:
        ValueError: If `start` is outside [0, 1], `steps` is below 1, or `align` is negative.
    """

    start: float = 0.5
    steps: int = 10
    align: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.start <= 1.0:
            raise ValueError(f"FEEG: start is {self.start}, but must lie in [0, 1]")
        if self.steps < 1:
            raise ValueError(f"FEEG: steps is {self.steps}, but must be at least 1")
        if self.align < 0:
            raise ValueError(f"FEEG: align is {self.align}, but must not be negative")

    def __call__(self, proposal: Tensor, reference: Reference[VelocityField]) -> Tensor:
        """Edit proposals; also within `torch.inference_mode()`, if what the expert flow holds was made outside it.

        Args:
            proposal: a_u, normalised chunks, shape (B, T, A).
            reference: Its expert flow, which must be differentiable in its first argument, and its generator.

        Returns:
            Edited chunks, shape (B, T, A), detached.
        """
        if self.start == 1.0:
            return proposal.detach()
        # LeRobot evaluates under inference mode, which `enable_grad` alone does not lift; tensors made in it must be
        # cloned outside before autograd takes them. Autocast would round the gradient.
        device = proposal.device.type
        with torch.inference_mode(False), torch.enable_grad(), torch.autocast(device, enabled=False):
            target = proposal.detach().clone()
            noise = randn(target.shape, reference.generator, like=target)
            x = interpolate(noise, target, times(self.start, target))
            if self.align == 0:  # nothing pulls back, so no gradient is to be paid for
                with torch.no_grad():
                    return integrate(reference.expert, x, self.start, 1.0, self.steps)
            step = (1.0 - self.start) / self.steps
            for k in range(self.steps):
                t = times(self.start + k * step, x)
                x = x.detach().requires_grad_()
                v = reference.expert(x, t)
                residual = (endpoint(x, t, v) - target).detach()
                gradient = residual
                if v.requires_grad:  # A field that does not depend on x has no Jacobian to pull back through.
                    (pulled,) = torch.autograd.grad(v, x, residual, allow_unused=True)
                    if pulled is not None:
                        gradient = endpoint(residual, t, pulled)
                x = x.detach() + step * (v.detach() - self.align * gradient)
            return x
