"""Whether a training has its observations by heart: episodes that it does not learn from tell."""

import logging

import torch
import torch.distributed as dist
from torch import Tensor, nn

EVERY = 20
"""One episode of so many is a witness."""
PASSES = 1.5
"""Passes over the data until the verdict. They are listened to in the second half: the first steps know nothing."""
BY_HEART = 1.08
"""Verdict: the context is doubted where the witnesses' error is more than so many times that of the others."""
FEW = 100
"""Episodes below which it is doubted from the beginning: there is nothing to spare, and soon nothing unknown."""


class Witnesses(nn.Module):
    """Episodes that a training leaves out until it knows whether it may believe what is observed.

    A network that recognises an observation knows the chunk that followed it without a look at what is proposed. In
    episodes that it has not learned from it then errs more than in the others, and this shows within the first passes
    over the data, long before it costs anything. After the verdict a witness is an episode like any other.

    Everything that it knows is in the checkpoint, so that a training which is resumed goes on. Where several processes
    train together, their buffers are those of the first before each step, and so is the verdict.

    Args:
        episodes: How many the dataset has; 0 if there is none, and nothing to be asked.
        frames: How many it has.
    """

    left: Tensor
    wait: Tensor
    errors: Tensor
    draws: Tensor
    doubted: Tensor

    def __init__(self, episodes: int = 0, frames: int = 0) -> None:
        super().__init__()
        wait = 0 if episodes < FEW else round(PASSES * frames)
        self.register_buffer("wait", torch.tensor(wait))
        self.register_buffer("left", torch.tensor(wait))
        self.register_buffer("errors", torch.zeros(2))
        self.register_buffer("draws", torch.zeros(2))
        self.register_buffer("doubted", torch.tensor(0 < episodes < FEW))

    @property
    def asked(self) -> bool:
        """Whether the verdict is still to come."""
        return bool(self.left > 0)

    @property
    def ratio(self) -> float:
        """Their mean error by that of the others so far; nan before either was heard."""
        others, theirs = (self.errors / self.draws).tolist()
        return theirs / others if others else float("nan")

    def among(self, episode: Tensor) -> Tensor:
        """Which items, of these episodes (B,), are theirs: bool (B,)."""
        return episode.flatten() % EVERY == EVERY - 1

    @torch.no_grad()
    def hear(self, error: Tensor, theirs: Tensor, items: int) -> None:
        """What a step of training has to say.

        Args:
            error: Distance of the mean from the expert's chunk, each with its own context (N,).
            theirs: Which of these are of witnesses, bool (N,).
            items: Items of the step in this process.
        """
        if 2 * self.left <= self.wait:
            for side, of in enumerate((~theirs, theirs)):
                self.errors[side] += error[of].sum()
                self.draws[side] += of.sum()
        self.left -= items * (dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1)
        if not self.asked:
            self.doubted.fill_(self.ratio > BY_HEART)
            said = "what is observed is known by heart, and doubted" if self.doubted else "what is observed is believed"
            logging.info("the witnesses' error is %.2f times that of the others: from here on %s", self.ratio, said)
