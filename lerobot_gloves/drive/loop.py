"""The simulation at the task's rate, whatever the pages do."""

import time
from collections.abc import Callable
from dataclasses import replace

from lerobot_gloves.drive.pacing import paced
from lerobot_gloves.drive.session import Driven, Snapshot

PATIENCE = 5
"""After so many steps in a row without the time to draw, one is drawn all the same."""


def run(
    session: Driven,
    rate: float,
    publish: Callable[[Snapshot], None],
    over: Callable[[], bool],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> None:
    """Step a session at a rate until it is over, and draw what there is time for.

    Steps go before pictures: a frame that would make the next step late is left out.

    Args:
        session: What is driven.
        rate: Steps a second.
        publish: Where snapshots go.
        over: Asked before each step.
        clock: Seconds that only grow.
        sleep: Waits for so many of them.
    """
    takes, left_out = 0.0, 0
    for due in paced(1 / rate, over, clock, sleep):
        snapshot = session.tick()
        began = clock()
        if due - began > takes or left_out >= PATIENCE:
            left_out = 0
            picture = session.draw()
            if picture is not snapshot.picture:
                takes += (clock() - began - takes) * (0.2 if takes else 1.0)
                snapshot = replace(snapshot, picture=picture)
        else:
            left_out += 1
        publish(snapshot)
