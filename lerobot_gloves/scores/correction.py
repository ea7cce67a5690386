"""How far a copilot would move a chunk: what it takes for wrong."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, endpoint, times


@dataclass(frozen=True)
class CorrectionScore:
    """Mean distance of an action from the posterior's mean, in normalised units; infinite for a repetition.

    Not in the paper. The mean is what the expert would do on average, given what is proposed and was proposed before:
    one evaluation, the endpoint estimate from zero noise at t = 0. No policy proposes the same twice to the last bit,
    so a proposal that is the last one again is a replay, however well it fits.

    Raises:
        ValueError: If the posterior that it needs is not there.
    """

    needs_posterior = True

    def __call__(
        self,
        velocity: VelocityField,
        chunk: Tensor,
        length: int | None = None,
        *,
        posterior: VelocityField | None = None,
        repeated: Tensor | None = None,
    ) -> Tensor:
        """Score chunks.

        Args:
            velocity: The expert flow, which it does not ask.
            chunk: Normalised chunks, shape (N, T, A).
            length: How many leading actions count; the rest is padding.
            posterior: The expert flow given what is proposed, bound to contexts and proposals.
            repeated: Which of the chunks are the last proposal again, bool (N,); None for none.

        Returns:
            Scores, shape (N,): low where the copilot would leave the chunk as it is.
        """
        if posterior is None:
            raise ValueError("correction needs an adapter that reads proposals: take a gloves_copilot")
        nothing, start = torch.zeros_like(chunk), times(0.0, chunk)
        mean = endpoint(nothing, start, posterior(nothing, start))
        distance = (mean - chunk)[:, :length].norm(dim=-1).mean(dim=-1)
        return distance if repeated is None else distance.masked_fill(repeated, math.inf)
