"""Several fields at once, as a batch of one network where they are of one."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField

type Evaluate = Callable[[Sequence[Tensor], Sequence[Tensor]], Sequence[Tensor]]


def side_by_side(fields: Sequence[VelocityField]) -> Evaluate:
    """Evaluate each field at points and times of its own, `evaluate(points, times)`.

    As one batch if the first field can stack them, `stack(others)`, as a `BoundVelocity` can those of its own network.
    """
    first, *others = fields
    stacked = first.stack(others) if hasattr(first, "stack") else None
    if stacked is None:
        return lambda points, t: [field(x, now) for field, x, now in zip(fields, points, t, strict=True)]
    return lambda points, t: stacked(torch.cat(list(points)), torch.cat(list(t))).chunk(len(fields))


class Foreseen:
    """A field that was asked at one point before anybody else asks there. Asked for a gradient, it is asked again.

    Args:
        field: The field.
        x: Where it was asked, (N, T, A), and `t`, (N,).
        velocity: What it answered.
    """

    def __init__(self, field: VelocityField, x: Tensor, t: Tensor, velocity: Tensor):
        self.field, self.x, self.t, self.velocity = field, x, t, velocity

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        known = not x.requires_grad and torch.equal(x, self.x) and torch.equal(t, self.t)
        return self.velocity if known else self.field(x, t)
