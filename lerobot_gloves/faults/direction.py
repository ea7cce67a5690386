"""Commands in the wrong direction: a frame askew, a person at the controls."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.fault import Fault, Range, Units, even
from lerobot_gloves.generators import rand


@dataclass(frozen=True)
class Rotated(Fault):
    """Two entries of the action turned about 0: a frame that stands askew.

    An entry and the one whose spread is most like its own, as those of a position are.
    """

    # The angle, in degrees, to either side.
    angle: Range = (10.0, 60.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        agents, entries = len(history), history.shape[-1]
        if entries < 2:
            return history.clone()
        side = torch.where(rand((agents, 1, 1), generator, like=history) < 0.5, -1.0, 1.0).to(history)
        angle = side * torch.deg2rad(even(self.angle, history, generator)[..., 0])
        spread = units.spread.to(history).log()
        unlike = (spread[:, None] - spread[None, :]).abs().fill_diagonal_(torch.inf)
        entry = (rand((agents,), generator, like=history) * entries).long()
        pair = torch.stack([entry, unlike.argmin(dim=1)[entry]], dim=-1)
        raw = units.raw(history)
        place = pair[:, None, None, :].expand(*history.shape[:3], 2)
        x, y = raw.gather(3, place).unbind(dim=-1)
        turned = torch.stack([angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y], dim=-1)
        return units.normalised(raw.scatter(3, place, turned))


@dataclass(frozen=True)
class Held(Fault):
    """A person's commands: late, held for a whole chunk, one of eight directions of the two largest entries."""

    # Speed of a command, in units of the chunk's own mean speed.
    speed: Range = (0.6, 1.4)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        meant = history.mean(dim=2, keepdim=True) - units.zero
        if history.shape[-1] > 1:
            largest = meant.abs().topk(2, dim=-1).indices
            pair = meant.gather(3, largest)
            angle = torch.atan2(pair[..., 1], pair[..., 0])
            snapped = (angle / (math.pi / 4)).round() * (math.pi / 4)
            held = torch.stack([snapped.cos(), snapped.sin()], dim=-1) * pair.norm(dim=-1, keepdim=True)
            meant = torch.zeros_like(meant).scatter(3, largest, held)
        late = torch.cat([meant[:, :1], meant[:, :-1]], dim=1)
        slow = rand((len(history), history.shape[1], 1, 1), generator, like=history) < 0.5
        command = torch.where(slow, late, meant) * even(self.speed, history, generator)
        return (units.zero + command).expand_as(history).clone()
