"""Expert flow, and agent flow if there is one, as what an adapter binds."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.editors import Reference
from lerobot_gloves.networks import BoundVelocity


class BoundFlow:
    """The flows of B contexts (see `lerobot_gloves.adapter.BoundAdapter`).

    Args:
        expert: v_e, which scores and is edited towards.
        agent: Binds v_u to the same contexts; None without. Only editors that need it pay for it.
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

    def edit(self, proposal: Tensor, editor: Any, **given: Any) -> Tensor:
        agent = self._agent_flow() if getattr(editor, "needs_agent", False) else None
        return editor(proposal, Reference(self.expert, agent, **given))

    @torch.no_grad()
    def _agent_flow(self) -> BoundVelocity | None:
        if self._agent is None and self._bind_agent is not None:
            self._agent = self._bind_agent()
        return self._agent
