"""The copilot of B contexts."""

from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor

from lerobot_gloves.editors import Reference
from lerobot_gloves.editors.together import Remembered
from lerobot_gloves.networks import BoundVelocity
from lerobot_gloves.networks.copilot import repeats, told
from lerobot_gloves.scores.score import needs_posterior


class BoundCopilot:
    """See `lerobot_gloves.adapter.BoundAdapter`.

    Args:
        expert: The flow of B contexts, told of no proposals.
        history: The last proposals (B, H, T, A), normalised, the oldest first, H of them or fewer; None for none yet.
        proposals: How many proposals the network reads.
        scored: What was scored of these contexts by the posterior, which an edit of the same need not ask again.
    """

    def __init__(self, expert: BoundVelocity, history: Tensor | None, proposals: int, scored: "Scored | None" = None):
        self.expert, self.history, self.proposals, self._scored = expert, history, proposals, scored
        self._posterior_evaluations = 0

    @property
    def evaluations(self) -> int:
        return self.expert.evaluations + self._posterior_evaluations

    def select(self, rows: Tensor) -> "BoundCopilot":
        history = None if self.history is None else self.history[rows]
        scored = None if self._scored is None else self._scored.select(rows)
        return BoundCopilot(self.expert.select(rows), history, self.proposals, scored)

    @torch.no_grad()
    def score(self, chunk: Tensor, score: Any, length: int | None = None) -> Tensor:
        if not needs_posterior(score):
            return score(self.expert, chunk, length=length)
        posterior, repeated = self._given(chunk)
        self._scored = Scored(chunk, Remembered(posterior))
        found = score(self.expert, chunk, length=length, posterior=self._scored.posterior, repeated=repeated)
        self._posterior_evaluations += posterior.evaluations
        return found

    def edit(self, proposal: Tensor, editor: Any, **given: Any) -> Tensor:
        if not getattr(editor, "needs_posterior", False) and not needs_posterior(given.get("score")):
            return editor(proposal, Reference(self.expert, **given))
        posterior, repeated = self._given(proposal)
        asked: BoundVelocity | Remembered = posterior
        if self._scored is not None and torch.equal(self._scored.chunk, proposal):
            asked = self._scored.posterior
            posterior = cast(BoundVelocity, asked.field)
        before = posterior.evaluations
        edited = editor(proposal, Reference(self.expert, posterior=asked, repeated=repeated, **given))
        self._posterior_evaluations += posterior.evaluations - before
        return edited

    def _given(self, proposal: Tensor) -> tuple[BoundVelocity, Tensor]:
        """The posterior's flow given proposals (B, T, A) and the last ones; which repeat the last one, bool (B,)."""
        before = proposal[:, None][:, :0] if self.history is None else self.history
        chunks = torch.cat([before, proposal[:, None]], dim=1)
        missing = self.proposals - chunks.shape[1]
        chunks = torch.cat([chunks[:, :1].expand(-1, missing, -1, -1), chunks], dim=1)
        there = (torch.arange(self.proposals, device=proposal.device) >= missing).expand(len(proposal), -1)
        return told(self.expert, chunks, there), repeats(chunks, there)[:, -1]


@dataclass(frozen=True)
class Scored:
    """Chunks (B, T, A) that were scored, and the posterior given them, at its last answer."""

    chunk: Tensor
    posterior: Remembered

    def select(self, rows: Tensor) -> "Scored":
        """The same for some of the B contexts."""
        return Scored(self.chunk[rows], self.posterior.select(rows))
