"""What a person commands at this moment, safe to be moved by one thread and read by another."""

import time
from collections.abc import Callable

HELD = 0.3
"""Seconds that a command holds without another one."""

type Position = tuple[float, float, float, float]
"""To the right, up on the picture and up in height, in [-1, 1] each, and the fingers: -1 opens, 1 closes, 0 neither."""

CENTRE: Position = (0.0, 0.0, 0.0, 0.0)


def still(position: Position) -> bool:
    """Whether the robot is to stand still there; its fingers may move."""
    return position[:3] == CENTRE[:3]


class Stick:
    """Goes back to its centre by itself when nobody has moved it for `HELD` seconds.

    Args:
        clock: Seconds that only grow.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._moved: tuple[Position, float] = (CENTRE, 0.0)

    def move(self, x: float, y: float, z: float = 0.0, grip: float = 0.0) -> None:
        """Hold it there, see `Position`."""
        self._moved = ((x, y, z, grip), self._clock())

    def release(self) -> None:
        """Nobody holds it."""
        self._moved = (CENTRE, self._clock())

    @property
    def position(self) -> Position:
        """Where it is now."""
        where, when = self._moved
        return where if self._clock() - when < HELD else CENTRE
