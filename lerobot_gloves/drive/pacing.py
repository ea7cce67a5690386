"""Steps at a fixed rate."""

import time
from collections.abc import Callable, Iterator


def paced(
    period: float,
    over: Callable[[], bool],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> Iterator[float]:
    """Yield once a period until it is over; what a step takes is part of its period.

    A step that comes late is followed by the next one at its own time, so that the rate holds. What is more than a
    period behind is not caught up with: a person cannot steer a simulation that runs ahead.

    Args:
        period: Seconds between two steps.
        over: Asked before each step.
        clock: Seconds that only grow.
        sleep: Waits for so many of them.

    Yields:
        The clock when the next step is due: what is left until then may be used for what can be left out.
    """
    due = clock()
    while not over():
        due += period
        yield due
        left = due - clock()
        if left > 0:
            sleep(left)
        elif left < -period:
            due -= left
