"""What a person commands at this moment, safe to be moved by one thread and read by another."""

import time
from collections.abc import Callable

HELD = 0.3
"""Seconds that a command holds without another one."""
CENTRE = (0.0, 0.0)


class Stick:
    """Goes back to its centre by itself when nobody has moved it for `HELD` seconds.

    Args:
        clock: Seconds that only grow.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._moved: tuple[tuple[float, float], float] = (CENTRE, 0.0)

    def move(self, x: float, y: float) -> None:
        """Hold it there, to the right and up, in [-1, 1] each."""
        self._moved = ((x, y), self._clock())

    def release(self) -> None:
        """Nobody holds it."""
        self._moved = (CENTRE, self._clock())

    @property
    def position(self) -> tuple[float, float]:
        """Where it is now."""
        where, when = self._moved
        return where if self._clock() - when < HELD else CENTRE
