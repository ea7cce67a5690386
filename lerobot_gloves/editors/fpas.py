"""FPAS: Flow-Prior Action Sampling (paper, section "FPAS")."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lerobot_gloves.editors.reference import Reference
from lerobot_gloves.flow import VelocityField
from lerobot_gloves.generators import randn


@dataclass(frozen=True)
class FPAS:
    """Search around the proposal for a chunk whose score the gate would admit, without a gradient.

    Each iteration weighs perturbed candidates by exp(-loss), with the violation
    loss(a) = max(s(a) - tau, 0) + align * ||a - a_u||^2, and moves by `edit` times their weighted perturbation.

    Attributes:
        iterations: Refinement steps, K.
        candidates: Candidates an iteration, n, the unperturbed chunk among them.
        sigma: Standard deviation of a perturbation, in normalised action units.
        edit: Step size, eta_edit; 0 leaves the proposal as it is.
        align: Weight of the distance to the proposal, lambda_align.
        needs_threshold: Whether it is of no use without a calibrated score, see `lerobot_gloves.adapter`.

    Raises:
        ValueError: If `candidates` or `iterations` is below 1, or `sigma` is negative.
    """

    iterations: int = 5
    candidates: int = 16
    sigma: float = 0.1
    edit: float = 1.0
    align: float = 0.05
    needs_threshold: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.candidates < 1:
            raise ValueError(f"FPAS: iterations and candidates must be at least 1, got {self}")
        if self.sigma < 0:
            raise ValueError(f"FPAS: sigma is {self.sigma}, but must not be negative")

    @torch.no_grad()
    def __call__(self, proposal: Tensor, reference: Reference[VelocityField]) -> Tensor:
        """Edit proposals.

        Args:
            proposal: a_u, normalised chunks, shape (B, T, A).
            reference: Its flows, which are called with n * B rows, score and threshold, its generator, and its
                length: score and distance leave out the padding.

        Returns:
            Edited chunks, shape (B, T, A), detached.

        Raises:
            ValueError: If there is no score or no threshold.
        """
        threshold, length = reference.threshold, reference.length
        if reference.score is None or threshold is None:
            raise ValueError(
                f"FPAS searches below the gate's threshold, but is given score {reference.score} and threshold "
                f"{threshold}: calibrate (gloves calibrate)"
            )
        if self.edit == 0:
            return proposal.detach()
        batch, (n, shape) = proposal.shape[0], (self.candidates, proposal.shape[1:])
        source, chunk = proposal[:, None], proposal
        for _ in range(self.iterations):
            noise = self.sigma * randn((batch * n, *shape), reference.generator, like=proposal).view(batch, n, *shape)
            # The zero perturbation keeps the current chunk among the candidates.
            noise = torch.cat([torch.zeros_like(noise[:, :1]), noise[:, 1:]], dim=1)
            candidate = chunk[:, None] + noise
            scores = reference.nonconformity(candidate.flatten(0, 1)).view(batch, n)
            # Where nothing is admitted, the violation is the score itself: weights do not feel a constant.
            violation = scores if threshold == -math.inf else (scores - threshold).clamp(min=0)
            loss = violation + self.align * (candidate - source)[:, :, :length].square().sum(dim=(2, 3))
            weight = torch.softmax(-loss, dim=1)
            chunk = chunk + self.edit * (weight[..., None, None] * noise).sum(dim=1)
        return chunk
