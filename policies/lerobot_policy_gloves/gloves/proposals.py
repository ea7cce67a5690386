"""The agent's proposals, taken where it makes them, whatever it does with them afterwards."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, cast

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor

# `select_action` of SmolVLA and XVLA calls the private one.
CHUNK_METHODS = ("_get_action_chunk", "predict_action_chunk")
# Where Diffusion and the multi-task DiT draw a chunk, of which they return no more than they execute.
SAMPLE_METHOD = "conditional_sample"
# Whose chunks are (n, B, A).
STEPS_FIRST = {"tdmpc"}


# Of these it is known that while actions are queued `select_action` reads nothing, or notes the last observations.
READ_WHERE_THEY_PLAN = {"act", "diffusion", "multi_task_dit", "smolvla", "gloves_expert_flow", "gloves_flow_policy"}


@dataclass(frozen=True)
class Proposal:
    """What an agent proposes.

    Attributes:
        actions: All that it proposes from now on, normalised, (B, n, A).
        executed: How many of them it will execute before it plans again, the first ones.
    """

    actions: Tensor
    executed: int


class ChunkTap:
    """Listens to a policy's own chunk prediction.

    An agent with an observation history or a replanning schedule must be asked for an action at every step. It keeps
    its queues to itself; what it proposes is seen here, at the moment it computes a chunk.
    """

    def __init__(self, policy: PreTrainedPolicy):
        self._chunk: Tensor | None = None
        self._sample: Tensor | None = None
        for name in CHUNK_METHODS:
            if hasattr(policy, name):
                _listen(policy, name, self._hear_chunk)
        for module in policy.modules():
            if hasattr(module, SAMPLE_METHOD):
                _listen(module, SAMPLE_METHOD, self._hear_sample)
        self._policy, self._config = policy, cast(Any, policy.config)
        # GR00T executes fewer than it is asked for where its checkpoint says so.
        self._executed: int | None = getattr(policy, "_action_queue_steps", None)
        self._ensembler: Any = getattr(policy, "temporal_ensembler", None)

    @property
    def unread(self) -> int:
        """For how many of the next steps the agent reads nothing of what it is shown; 0 where nobody knows."""
        if self._config.type not in READ_WHERE_THEY_PLAN or self._ensembler is not None:
            return 0
        queue = getattr(self._policy, "_action_queue", None)
        if queue is None:
            queue = getattr(self._policy, "_queues", {}).get(ACTION, ())
        return max(0, len(queue) - (self._config.n_obs_steps - 1))

    def _hear_chunk(self, chunk: Any) -> None:
        self._chunk = chunk

    def _hear_sample(self, sample: Any) -> None:
        self._sample = sample

    def clear(self) -> None:
        """Forget the last chunk."""
        self._chunk = self._sample = None

    def proposal(self, action: Tensor) -> Proposal | None:
        """What the agent has planned at this step; None if it did not plan, or plans no chunks.

        Args:
            action: What the agent returned for this step, (B, A). An agent that blends chunks into one another
                (ACT's temporal ensembling) returns something else than its chunk's first action: its proposal are the
                blended ones.
        """
        if self._chunk is None or self._chunk.ndim != 3:
            return None
        chunk = self.by_environment(self._chunk)
        if chunk.shape[0] != action.shape[0]:
            return None
        # TDMPC may repeat the first action of its plan in the place of the next ones.
        repeats = getattr(self._config, "n_action_repeats", 1)
        executed = max(self._executed or getattr(self._config, "n_action_steps", None) or chunk.shape[1], repeats)
        rest = self.whole(chunk)[:, repeats:]
        if self._ensembler is not None:
            rest = self._ensembler.ensembled_actions
        actions = torch.cat([action[:, None].expand(-1, repeats, -1), rest], dim=1)
        return Proposal(actions, min(executed, actions.shape[1]))

    def by_environment(self, chunk: Tensor) -> Tensor:
        """A chunk as the policy returns it, (B, n, A)."""
        return chunk.transpose(0, 1) if self._config.type in STEPS_FIRST else chunk

    def whole(self, chunk: Tensor) -> Tensor:
        """A chunk (B, n, A) that the policy has just returned, with what it drew beyond its end, (B, m, A), m >= n."""
        if self._sample is None:
            return chunk
        # A chunk's first actions are those of the observations that lie behind.
        drawn = self._sample[:, self._config.n_obs_steps - 1 :]
        return drawn if torch.equal(drawn[:, : chunk.shape[1]], chunk) else chunk


def _listen(owner: Any, name: str, hear: Callable[[Any], None]) -> None:
    method = getattr(owner, name)

    @wraps(method)
    def listened(*args: Any, **kwargs: Any) -> Any:
        result = method(*args, **kwargs)
        hear(result)
        return result

    owner.__dict__[name] = listened
