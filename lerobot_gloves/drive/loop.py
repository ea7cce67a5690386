"""The simulation at the task's rate, whatever the pages do."""

import time
from collections.abc import Callable
from dataclasses import replace

from lerobot_gloves.drive.pacing import paced
from lerobot_gloves.drive.session import Driven, Snapshot

MARGIN = 1.3
"""Times the slowest frame of late that has to be left of a step for a frame: other programs want the cores as well."""
PATIENCE = 4
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

    Steps go before pictures: each is published before its frame is drawn, and a frame that would make the next step
    late is left out.

    Args:
        session: What is driven.
        rate: Steps a second.
        publish: Where snapshots go; of a step that is drawn one without the frame and one with it.
        over: Asked before each step.
        clock: Seconds that only grow.
        sleep: Waits for so many of them.
    """
    takes, left_out = 0.0, 0
    for due in paced(1 / rate, over, clock, sleep):
        snapshot = session.tick()
        publish(snapshot)
        began = clock()
        if due - began > MARGIN * takes or left_out >= PATIENCE:
            left_out = 0
            picture = session.draw()
            if picture is not snapshot.picture:
                took = clock() - began
                takes = max(took, takes + 0.3 * (took - takes))  # the next one may be as slow as the slowest of late
                publish(replace(snapshot, picture=picture))
        else:
            left_out += 1
