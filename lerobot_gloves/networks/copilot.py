"""A velocity field conditioned on what an agent proposes and proposed, besides what is observed."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_gloves.networks.velocity import BoundVelocity, VelocityNetwork

_LIKE_DATA = 3.0
"""Standard deviations."""


class CopilotNetwork(VelocityNetwork):
    """The network of `VelocityNetwork`, which reads each action of a chunk beside those proposed for that place.

    Bound to observations alone it is the expert's flow; `told` makes it the posterior given proposals.

    Args:
        action_dim: A.
        proposals: How many proposals it reads, the one to be corrected among them, K.
        network: The other arguments of `VelocityNetwork`.
    """

    def __init__(self, action_dim: int, *, proposals: int, **network: object):
        self.beside_dim = proposals * (action_dim + 2)
        super().__init__(action_dim, beside_dim=self.beside_dim, **network)  # type: ignore[arg-type]

    def bind(
        self, observation: Mapping[str, Tensor], guidance: float = 1.0, tokens: Tensor | None = None
    ) -> BoundVelocity:
        """See `VelocityNetwork.bind`."""
        bound = super().bind(observation, guidance, tokens)
        key, _ = bound.context[0]
        return bound.with_beside(key.new_zeros(key.shape[0], 1, self.beside_dim))


def told(bound: BoundVelocity, proposals: Tensor, there: Tensor) -> BoundVelocity:
    """The field of a `CopilotNetwork`'s B contexts given what was proposed in them, and what of it came again.

    Args:
        bound: What its `bind` returned.
        proposals: Normalised chunks (B, K, T, A), the oldest first, the one to be corrected last.
        there: Which of them are told, bool (B, K): at an episode's beginning there are fewer.
    """
    marks = torch.stack([there, repeats(proposals, there)], dim=-1)[:, :, None].to(proposals.dtype)
    # As they are while they are like the data, by their logarithm where they are far from any.
    near = _LIKE_DATA * torch.asinh(proposals / _LIKE_DATA)
    marked = torch.cat([near * marks[..., :1], marks.expand(*proposals.shape[:3], 2)], dim=-1)
    return bound.with_beside(marked.transpose(1, 2).flatten(2))


def repeats(proposals: Tensor, there: Tensor) -> Tensor:
    """Which of proposals (B, K, T, A) are the one before them again, which was told: bool (B, K).

    No policy proposes the same twice to the last bit: what comes again says nothing of what is wanted now.
    """
    again = (proposals[:, 1:] == proposals[:, :-1]).flatten(2).all(dim=2) & there[:, :-1]
    return torch.cat([torch.zeros_like(there[:, :1]), again], dim=1)
