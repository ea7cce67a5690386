"""The copilot's edit: what the expert would do on average, given what is proposed."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from lerobot_gloves.editors.reference import Reference
from lerobot_gloves.editors.together import Remembered, side_by_side
from lerobot_gloves.flow import VelocityField, endpoint, times


@dataclass(frozen=True)
class Copilot:
    """One evaluation: the mean of the expert's chunks, given the context, the proposal and the last ones.

    A flow's endpoint estimate from zero noise at t = 0 is that mean, if training has shown it that point.

    Attributes:
        limit: Largest mean distance of an action from the proposed one, in normalised units, where the score admits the
            proposal and it does not repeat the last one exactly; below 0 there is none, and no score is asked.

    Raises:
        ValueError: If the posterior that it needs is not there.
    """

    limit: float = 0.4
    needs_posterior = True

    @property
    def needs_threshold(self) -> bool:
        """Whether it asks a score."""
        return self.limit >= 0

    @torch.no_grad()
    def __call__(self, proposal: Tensor, reference: Reference[VelocityField]) -> Tensor:
        """Edit proposals (B, T, A), see `Reference`."""
        posterior, threshold = reference.posterior, reference.threshold
        if posterior is None:
            raise ValueError("copilot needs an adapter that reads proposals: take a gloves_copilot")
        nothing, start = torch.zeros_like(proposal), times(0.0, proposal)
        if not self.needs_threshold:
            return endpoint(nothing, start, posterior(nothing, start))
        assert reference.score is not None and threshold is not None
        expert = reference.expert
        if getattr(reference.score, "starts_at_chunk", False):
            # The score's first evaluation shares a batch with the only one here.
            evaluate, end = side_by_side([posterior, expert]), times(1.0, proposal)
            told, alone = evaluate([nothing, proposal], [start, end])
            expert = Remembered(expert, proposal, end, alone)
        else:
            told = posterior(nothing, start)
        mean = endpoint(nothing, start, told)
        known = Remembered(posterior, nothing, start, told)  # a score may ask for the mean as well
        free = replace(reference, expert=expert, posterior=known).nonconformity(proposal) > threshold
        if reference.repeated is not None:
            free |= reference.repeated
        edit = mean - proposal
        distance = edit[:, : reference.length].norm(dim=-1).mean(dim=-1)
        share = (self.limit / distance.clamp(min=1e-9)).clamp(max=1.0)
        return proposal + edit * torch.where(free, 1.0, share)[:, None, None]
