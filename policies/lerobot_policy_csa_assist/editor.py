"""CSA: one evaluation of a consistency function (Sun et al. 2025)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.editors import Reference

from .edm import Denoiser


@dataclass(frozen=True)
class CSA:
    """Take the proposal for a noisy chunk, and the student's one-step denoising of it for the corrected one.

    No noise is added: the proposal as it is goes in as a sample at the sigma of `level`. The higher sigma is, the less
    of the proposal is believed.

    Attributes:
        level: Index in Karras' grid, counted as FlashBack counts, from 0 at sigma_max down to levels - 1 at sigma_min,
            where the proposal is kept. Of the default 80 levels 10 is sigma 38.6 and 60 is sigma 0.15.
        blend: Weight of the proposal in a final average with the student's chunk; 1 keeps the proposal.

    Raises:
        ValueError: If `level` is negative or `blend` is outside [0, 1].
    """

    level: int = 40
    blend: float = 0.0

    def __post_init__(self) -> None:
        if self.level < 0:
            raise ValueError(f"CSA: level is {self.level}, but must not be negative")
        if not 0.0 <= self.blend <= 1.0:
            raise ValueError(f"CSA: blend is {self.blend}, but must lie in [0, 1]")

    @torch.no_grad()
    def __call__(self, proposal: Tensor, reference: Reference[Denoiser]) -> Tensor:
        """Edit proposals.

        Args:
            proposal: a_u, normalised chunks, shape (B, T, A).
            reference: The consistency function, or student, bound to the B contexts.

        Returns:
            Edited chunks, shape (B, T, A), detached.

        Raises:
            ValueError: If the student's grid has no such level.
        """
        if self.blend == 1.0:
            return proposal.detach()
        student = reference.expert
        levels = student.noise.levels
        if self.level >= levels:
            raise ValueError(f"CSA: level is {self.level}, but the student's levels are 0 to {levels - 1}")
        sigma = student.noise.grid(like=proposal)[self.level]
        corrected = student(proposal, sigma.expand(len(proposal)))
        return self.blend * proposal + (1 - self.blend) * corrected
