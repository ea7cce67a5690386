"""IFAE: Inversion-Free Action-Chunk Editing (paper, section "IFAE" and Algorithm 1)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from lerobot_gloves.editors.reference import Reference
from lerobot_gloves.editors.together import side_by_side
from lerobot_gloves.flow import VelocityField, endpoint, interpolate, times
from lerobot_gloves.generators import randn


@dataclass(frozen=True)
class IFAE:
    """Carry the proposal from the agent's distribution to the expert's, along the difference of their flows.

    Step k noises the proposal afresh to q_k, adds the edit so far to get p_k, and moves the edit by

        edit * dt * (v_p - v_q) + align * (a_u_hat - a_e_hat),

    with v_q = v_u(q_k), v_p = v_u(p_k) + guidance * (v_e(p_k) - v_u(p_k)) and the endpoint estimates of q_k and p_k.

    Attributes:
        steps: Steps K from `start` to 1.
        edit: Step size, eta_edit.
        align: Pull of an endpoint back to the agent's, lambda_align, at every step and not scaled by its length.
        guidance: Weight omega of the expert against the agent at p_k; at 1 the agent is not evaluated there.
        start: Time t_0 of the first step. The paper's is 0, where the first step does not look at the proposal: where
            the expert has modes that the agent's flow lacks, a later start keeps more of what the agent meant.
        needs_agent: Whether it is of no use without an agent flow, see `lerobot_gloves.adapter`.

    Raises:
        ValueError: If `steps` is below 1, `start` is outside [0, 1), or `align` is negative or so large that it undoes
            the edit.
    """

    steps: int = 10
    edit: float = 1.0
    align: float = 0.01
    guidance: float = 1.0
    start: float = 0.0
    needs_agent: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"IFAE: steps is {self.steps}, but must be at least 1")
        if not 0.0 <= self.start < 1.0:
            raise ValueError(f"IFAE: start is {self.start}, but must lie in [0, 1)")
        bound = self.edit * (1.0 - self.start) / self.steps
        if not 0.0 <= self.align <= bound + 1e-9:  # in floating point, 0.7 / 10 is not 0.07
            raise ValueError(
                f"IFAE: align is {self.align}, but must lie in [0, {bound:.3g}]: above edit * (1 - start) / steps each "
                "step pulls back more than it edits, and the edit undoes itself"
            )

    @torch.no_grad()
    def __call__(self, proposal: Tensor, reference: Reference[VelocityField]) -> Tensor:
        """Edit proposals.

        Args:
            proposal: a_u, normalised chunks, shape (B, T, A).
            reference: Its expert flow v_e, its agent flow v_u, and its generator, source of the noise that is fresh at
                every step. If the agent flow offers `stack(others)`, as a `BoundVelocity` does for the fields of its
                own network, a step is one evaluation of one batch.

        Returns:
            Edited chunks, shape (B, T, A), detached.

        Raises:
            ValueError: If there is no agent flow.
        """
        expert, agent = reference.expert, reference.agent
        if agent is None:
            raise ValueError("IFAE: the reference has no agent flow, v_u, whose difference from v_e is followed")
        guided = self.guidance != 1.0
        evaluate = side_by_side([agent, expert, agent] if guided else [agent, expert])
        chunk, step = proposal, (1.0 - self.start) / self.steps
        for k in range(self.steps):
            t = times(self.start + k * step, proposal)
            q = interpolate(randn(proposal.shape, reference.generator, like=proposal), proposal, t)
            p = q + (chunk - proposal)
            v_q, v_p, *base = evaluate([q, p, p] if guided else [q, p], [t, t, t] if guided else [t, t])
            if guided:
                v_p = base[0] + self.guidance * (v_p - base[0])
            pull = endpoint(q, t, v_q) - endpoint(p, t, v_p)
            chunk = chunk + self.edit * step * (v_p - v_q) + self.align * pull
        return chunk
