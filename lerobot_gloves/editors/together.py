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


class Remembered:
    """A field that is not evaluated again where it was asked last, unless for a gradient.

    Args:
        field: The field.
        x: Where it was asked already, (N, T, A), and `t`, (N,).
        velocity: What it answered; None for not asked yet.
    """

    def __init__(
        self, field: VelocityField, x: Tensor | None = None, t: Tensor | None = None, velocity: Tensor | None = None
    ):
        self.field, self._x, self._t, self._velocity = field, x, t, velocity

    def __call__(self, x: Tensor, t: Tensor) -> Tensor:
        if x.requires_grad:
            return self.field(x, t)
        if self._velocity is None or not self._asked(x, t):
            self._x, self._t, self._velocity = x, t, self.field(x, t)
        return self._velocity

    def _asked(self, x: Tensor, t: Tensor) -> bool:
        return self._x is not None and self._t is not None and torch.equal(x, self._x) and torch.equal(t, self._t)

    def select(self, rows: Tensor) -> "Remembered":
        """Of some of the contexts, bool (B,), where it was asked once for each of them at most."""
        field = self.field.select(rows)  # type: ignore[attr-defined]
        if self._x is None or self._t is None or self._velocity is None or len(self._x) != len(rows):
            return Remembered(field)
        return Remembered(field, self._x[rows], self._t[rows], self._velocity[rows])
