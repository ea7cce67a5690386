"""DDPM: noise the proposal, then denoise it (Yoneda et al. 2023)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.editors import Reference
from lerobot_gloves.generators import randn

from .diffusion import Diffusion


@dataclass(frozen=True)
class DDPM:
    """Diffuse the proposal forward to step k = int((N - 1) gamma), then take k ancestral steps back.

    They end at step 0, whose trace of noise is the sqrt(beta) that the original adds after its last step.

    Attributes:
        gamma: Share of the diffusion: 0 keeps the proposal, 1 all but resamples from the expert.

    Raises:
        ValueError: If `gamma` is outside [0, 1].
    """

    gamma: float = 0.4

    def __post_init__(self) -> None:
        if not 0.0 <= self.gamma <= 1.0:
            raise ValueError(f"DDPM: gamma is {self.gamma}, but must lie in [0, 1]")

    @torch.no_grad()
    def __call__(self, proposal: Tensor, reference: Reference[Diffusion]) -> Tensor:
        """Edit proposals.

        Args:
            proposal: a_u, normalised chunks, shape (B, T, A).
            reference: The diffusion of the expert's chunks, bound to the B contexts, and its generator.

        Returns:
            Edited chunks, shape (B, T, A), detached.
        """
        expert, generator = reference.expert, reference.generator
        last = int((expert.steps - 1) * self.gamma)
        if last == 0:
            return proposal.detach()
        noise = randn(proposal.shape, generator, like=proposal)
        noised = expert.noised(proposal, noise, torch.full((len(proposal),), last, device=proposal.device))
        return expert.denoise(noised, range(last, 0, -1), generator)
