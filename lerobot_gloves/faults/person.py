"""A person at the controls, who is asked at every action."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.fault import Fault, Range, Units, even
from lerobot_gloves.generators import rand

ACROSS = math.sin(math.pi / 8)
"""Share of a movement's length from which on a key is pressed for an entry: of two entries, one of eight directions."""

HARDLY = 0.3
"""Share of the largest spread below which an entry hardly moves."""


@dataclass(frozen=True)
class Driven(Fault):
    """Keys pressed late, held for some decisions, now and then the wrong neighbouring one; each chunk is its command.

    Decisions are one action apart, as a person's are (`--policy.decision_every=1`). Of the entries that move, each is
    commanded to one side, to the other or not at all, at a speed that an agent has for itself. Those that hardly move
    have no key. An entry that only switches, such as a gripper's, is late alone.
    """

    # How late a command is, in actions, as far back as the history goes.
    late: Range = (0.0, 11.0)
    # How many actions of the expert's are looked at to tell where it is going.
    ahead: Range = (1.0, 10.0)
    # For how many actions a command is held before it is thought over.
    held: Range = (1.0, 8.0)
    # Speed, in units of the expert's largest.
    speed: Range = (0.8, 1.2)
    # Probability that a command is a slip: one key too many or too few.
    slips: Range = (0.0, 0.15)
    # Probability that nothing is commanded, of decisions that are past.
    waits: Range = (0.0, 0.3)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        agents, decisions, _, entries = history.shape
        raw = units.raw(torch.cat([history[:, :, 0], history[:, -1, 1:]], dim=1))  # one action a step
        size = raw.abs()
        largest = size.amax(dim=1, keepdim=True)
        switch = (largest > 0) & (largest - size.amin(dim=1, keepdim=True) < 1e-3 * largest)
        spread = torch.where(units.varies & ~switch, units.spread, 0.0).to(history)
        moves = (spread > 0) & (spread >= HARDLY * spread.amax(dim=2, keepdim=True))

        held, late, ahead = (
            even(bounds, history, generator)[:, 0, 0].long() for bounds in (self.held, self.late, self.ahead)
        )
        phase = (rand((agents, 1), generator, like=history) * held).long()
        now = torch.arange(decisions, device=history.device)[None]
        block = torch.div(now + phase, held, rounding_mode="floor")
        seen = (block * held - phase - late).clamp(min=0)
        summed = torch.cat([torch.zeros_like(raw[:, :1]), raw], dim=1).cumsum(dim=1)
        until = (seen + ahead).clamp(max=raw.shape[1])

        def at(values: Tensor, place: Tensor) -> Tensor:
            return values.gather(1, place[..., None].expand(-1, -1, values.shape[-1]))

        meant = torch.where(moves, at(summed, until) - at(summed, seen), 0.0)
        pressed = torch.where(
            meant.abs() >= ACROSS * meant.norm(dim=-1, keepdim=True).clamp(min=1e-12), meant.sign(), 0.0
        )

        def per_block(p: Range) -> Tensor:
            chance = rand((agents, decisions + 1, 1), generator, like=history)
            return at(chance, block.clamp(max=decisions)) < even(p, history, generator)[:, 0]

        entry = torch.nn.functional.one_hot(
            (at(rand((agents, decisions + 1, 1), generator, like=history), block)[..., 0] * entries).long(), entries
        )
        side = torch.where(at(rand((agents, decisions + 1, 1), generator, like=history), block) < 0.5, -1.0, 1.0)
        slip = torch.where(pressed == 0, side.to(history), 0.0)
        pressed = torch.where(per_block(self.slips) & entry.bool() & moves, slip, pressed)
        past = now[..., None] < decisions - 1
        pressed = torch.where(per_block(self.waits) & past, 0.0, pressed)
        fastest = torch.where(moves, raw, 0.0).norm(dim=-1, keepdim=True).amax(dim=1, keepdim=True)
        pressed = pressed / pressed.norm(dim=-1, keepdim=True).clamp(min=1.0)
        command = pressed * fastest * even(self.speed, history, generator)[:, 0]
        command = torch.where(switch, at(raw, seen), command)
        return units.normalised(command)[:, :, None].expand_as(history).clone()


NEVER = (0.0, 0.0)
PROMPT = Driven(late=NEVER, held=(1.0, 1.0), speed=(1.0, 1.0), slips=NEVER, waits=NEVER)
"""Somebody who goes the expert's way with keys, thinks at every step, and is neither late nor wrong."""
