"""The agent's proposals, taken where it makes them, whatever it does with them afterwards."""

from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

# `select_action` of SmolVLA and XVLA calls the private one.
CHUNK_METHODS = ("_get_action_chunk", "predict_action_chunk")


class ChunkTap:
    """Listens to a policy's own chunk prediction.

    An agent with an observation history or a replanning schedule must be asked for an action at every step. It keeps
    its queues to itself; what it proposes is seen here, at the moment it computes a chunk.

    Attributes:
        chunk: The normalised chunk (B, n, A) computed since `clear`, None if there was none.
    """

    def __init__(self, policy: PreTrainedPolicy):
        self.chunk: Tensor | None = None
        base = policy.get_base_model() if hasattr(policy, "get_base_model") else policy
        for name in CHUNK_METHODS:
            if hasattr(base, name):
                base.__dict__[name] = self._listen(getattr(base, name))
        config = base.config
        self._executed = getattr(config, "n_action_steps", None)

    def _listen(self, method: Any) -> Any:
        def predict(*args: Any, **kwargs: Any) -> Any:
            chunk = method(*args, **kwargs)
            self.chunk = chunk
            return chunk

        return predict

    def clear(self) -> None:
        """Forget the last chunk."""
        self.chunk = None

    def proposal(self, action: Tensor) -> Tensor | None:
        """The actions that the agent will execute until it plans again, normalised, (B, n, A).

        Args:
            action: What the agent returned for this step, (B, A). An agent that blends chunks into one another
                (ACT's temporal ensembling) returns something else than its chunk's first action.

        Returns:
            The proposal, or None if the agent did not plan at this step, or plans no chunks.
        """
        chunk = self.chunk
        if chunk is None or chunk.ndim != 3:
            return None
        batch_size = action.shape[0]
        # TDMPC's chunks are (n, B, A); where n is B, their values tell.
        if chunk.shape[1] == batch_size and (chunk.shape[0] != batch_size or torch.equal(chunk[0], action)):
            chunk = chunk.transpose(0, 1)
        if chunk.shape[0] != batch_size:
            return None
        rest = chunk[:, 1 : self._executed]
        return torch.cat([action[:, None], rest], dim=1)
