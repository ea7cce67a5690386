"""Expert flow, and agent flow if there is one, as what an adapter binds."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.editors import FPAS, IFAE
from lerobot_gloves.generators import Generators
from lerobot_gloves.networks import BoundVelocity


class BoundFlow:
    """The flows of B contexts (see `lerobot_gloves.adapter.BoundAdapter`).

    Args:
        expert: v_e, which scores and is edited towards.
        agent: Binds v_u to the same contexts. Only IFAE needs it, so only IFAE's edits pay for it; None without.
    """

    def __init__(self, expert: BoundVelocity, agent: Callable[[], BoundVelocity] | None = None):
        self.expert, self._bind_agent = expert, agent
        self._agent: BoundVelocity | None = None

    @property
    def evaluations(self) -> int:
        return self.expert.evaluations + (self._agent.evaluations if self._agent is not None else 0)

    def select(self, rows: Tensor) -> "BoundFlow":
        bind = self._bind_agent
        return BoundFlow(self.expert.select(rows), None if bind is None else lambda: bind().select(rows))

    @torch.no_grad()
    def score(self, chunk: Tensor, score: Any, length: int | None = None) -> Tensor:
        return score(self.expert, chunk, length=length)

    def edit(
        self,
        proposal: Tensor,
        editor: Any,
        *,
        score: Any,
        threshold: float | None,
        length: int | None = None,
        generator: Generators = None,
    ) -> Tensor:
        if isinstance(editor, IFAE):
            return editor(proposal, self.expert, self._agent_flow(), generator=generator)
        if not isinstance(editor, FPAS):
            return editor(proposal, self.expert, generator=generator)
        if threshold is None:
            raise ValueError("fpas searches below the gate's threshold: calibrate the adapter (gloves calibrate)")
        return editor(proposal, self.expert, score=score, threshold=threshold, length=length, generator=generator)

    @torch.no_grad()
    def _agent_flow(self) -> BoundVelocity:
        if self._bind_agent is None:
            raise ValueError(
                "ifae needs the agent's flow besides the expert's: take a gloves_align_flow as adapter, or name one "
                """by --policy.adapter_overrides='["--agent_flow=<checkpoint>"]'"""
            )
        if self._agent is None:
            self._agent = self._bind_agent()
        return self._agent
