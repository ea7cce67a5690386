"""From what an agent plans, normalised, to the raw actions that it means by it."""

import torch
from torch import Tensor

from lerobot_gloves.checkpoints.processors import Pipeline

_PROBES, _FEW = 64, 3


class Decoder:
    """An agent's postprocessor, applied to a whole plan at the moment it is made.

    LeRobot's commands decode action by action, (B, A), each when it is due; its real-time chunking decodes chunks,
    (B, n, A), as they are made. A postprocessor that gives the same for a chunk's first action either way is given
    chunks, since to it an action's place in its chunk may matter (GR00T's); any other is given action after action.

    Args:
        postprocess: The agent's postprocessor. It is taken to keep nothing from one action to the next.
    """

    def __init__(self, postprocess: Pipeline):
        self._postprocess = postprocess
        self._by_chunk: bool | None = None
        self._discrete: dict[int, Tensor] = {}

    def __call__(self, plan: Tensor) -> Tensor:
        """Raw actions (B, n, A) of normalised ones (B, n, A')."""
        if self._by_chunk is None:
            self._by_chunk = self._takes_chunks(plan)
            self._discrete = self._find_discrete(plan[:, :1])
            self._postprocess.reset()
        return self._decode(plan)

    def snap(self, edited: Tensor) -> Tensor:
        """Edited raw actions (..., A) with the values that the agent's can have, where these are but a few.

        Such as a gripper's, which is open or closed: the nearest of them.
        """
        snapped = edited.clone()
        for entry, values in self._discrete.items():
            nearest = (edited[..., entry, None] - values.to(edited)).abs().argmin(dim=-1)
            snapped[..., entry] = values.to(edited)[nearest]
        return snapped

    def _decode(self, plan: Tensor) -> Tensor:
        if self._by_chunk:
            return self._postprocess(plan.clone())
        return torch.stack([self._postprocess(action) for action in plan.clone().unbind(dim=1)], dim=1)

    def _takes_chunks(self, plan: Tensor) -> bool:
        try:
            whole, one = self._postprocess(plan.clone()), self._postprocess(plan[:, :1].clone())
        except Exception:  # whatever a processor raises that was not made for chunks
            return False
        try:
            alone = self._postprocess(plan[:, 0].clone())
        except NotImplementedError:  # GR00T's relative actions are decoded by the chunk or not at all
            return True
        if whole.ndim != 3 or one.ndim != 3 or whole.shape[:2] != plan.shape[:2]:
            return False
        return torch.equal(whole[:, 0], alone) and torch.equal(one[:, 0], alone)

    def _find_discrete(self, like: Tensor) -> dict[int, Tensor]:
        """Entries of the raw action that have two or three values whatever is planned, and these values."""
        drawn = 2 * torch.randn(_PROBES, like.shape[-1], generator=torch.Generator().manual_seed(0))
        raw = torch.stack([self._decode(probe.to(like).expand_as(like))[0, 0] for probe in drawn])
        found = {entry: values.unique() for entry, values in enumerate(raw.unbind(dim=1))}
        # Not what differs by its rounding alone.
        apart = {entry: values.diff().min() > 1e-3 for entry, values in found.items() if 1 < len(values) <= _FEW}
        return {entry: found[entry] for entry, far in apart.items() if far}
