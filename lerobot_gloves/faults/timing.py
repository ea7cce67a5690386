"""What is proposed comes again, late, or not at all."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.fault import Fault, Range, Units, even, happens
from lerobot_gloves.generators import rand


@dataclass(frozen=True)
class Replay(Fault):
    """The chunk last emitted comes again instead of the new one."""

    # Probability of a repetition at a decision.
    p: Range = (0.1, 0.7)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        repeats = happens(self.p, history, generator)
        emitted = [history[:, 0]]
        for decision in range(1, history.shape[1]):
            emitted.append(torch.where(repeats[:, decision], emitted[-1], history[:, decision]))
        return torch.stack(emitted, dim=1)


@dataclass(frozen=True)
class Delay(Fault):
    """Every action comes some steps late, the first one until then."""

    # How many steps, as a share of a chunk's length.
    steps: Range = (0.1, 1.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        actions = history.flatten(1, 2)
        late = (even(self.steps, history, generator)[:, 0, 0] * history.shape[2]).round().long().clamp(min=1)
        source = (torch.arange(actions.shape[1], device=history.device)[None] - late).clamp(min=0)
        return actions.gather(1, source[..., None].expand_as(actions)).view_as(history)


@dataclass(frozen=True)
class Dropped(Fault):
    """Single actions are lost: 0 comes in their place."""

    # Probability that an action is lost.
    p: Range = (0.05, 0.5)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        lost = rand((*history.shape[:3], 1), generator, like=history) < even(self.p, history, generator)
        return torch.where(lost, units.zero, history)
