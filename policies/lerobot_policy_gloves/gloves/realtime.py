"""What LeRobot's real-time chunking gives back: the prefix that the next chunk is to begin with."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class LeftOver:
    """A prefix of fixed length: what is left of the last chunk, cut off, or filled up by zeros.

    The zeros are no actions: LeRobot fills up what a policy returns, which is normalised but for a wrapper's.

    Attributes:
        actions: What is left of the chunk, raw, (m, A).
        padding: How many zeros follow.
        ran: How many actions of the chunk had been executed; None if it is not the last chunk's.
    """

    actions: Tensor
    padding: int
    ran: int | None

    @classmethod
    def of(cls, chunk: Tensor | None, prefix: Tensor) -> "LeftOver":
        """Read a prefix (n, A) by the chunk (N, A) that it is said to be left of, as that was returned.

        An action that is zero by itself is told from padding by its place in the chunk. Of a prefix from elsewhere, the
        zeros at its end are taken for padding.
        """
        length = len(prefix)
        if chunk is not None and chunk.shape[1:] == prefix.shape[1:]:
            chunk = chunk.to(prefix)
            for ran in range(len(chunk) + 1):
                left = chunk[ran : ran + length]
                if torch.equal(prefix[: len(left)], left) and not prefix[len(left) :].any():
                    return cls(left, length - len(left), ran)
        used = prefix.any(dim=1).nonzero()
        count = int(used[-1]) + 1 if len(used) else 0
        return cls(prefix[:count], length - count, None)
