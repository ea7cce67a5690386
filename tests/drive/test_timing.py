"""The 300 ms rule and the rate of the loop, by a clock that stands still until it is told to go on."""

import itertools
from types import SimpleNamespace

import pytest

from lerobot_gloves.drive.loop import PATIENCE, run
from lerobot_gloves.drive.pacing import paced
from lerobot_gloves.drive.session import Snapshot
from lerobot_gloves.drive.stick import CENTRE, Stick


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


def test_a_command_holds_for_less_than_300_ms():
    clock = Clock()
    stick = Stick(clock)
    assert stick.position == CENTRE
    stick.move(0.5, -1.0)
    clock.now += 0.299
    assert stick.position == (0.5, -1.0, 0.0, 0.0)
    clock.now += 0.002
    assert stick.position == CENTRE
    stick.move(0.5, -1.0)
    stick.release()
    assert stick.position == CENTRE


def steps(takes, count: int) -> list[float]:
    """When each of so many steps of 50 ms begins, each taking as long as told, seconds from the first."""
    clock, begun = Clock(), []
    for _, seconds in zip(paced(0.05, lambda: len(begun) == count, clock, clock.sleep), takes, strict=False):
        begun.append(clock.now - 100.0)
        clock.now += seconds
    return begun


def test_steps_come_at_the_rate_whatever_they_take_of_it():
    assert steps(itertools.cycle([0.001, 0.03, 0.049]), 30) == pytest.approx([0.05 * i for i in range(30)])


def test_after_a_late_step_the_next_one_comes_at_its_own_time():
    assert steps([0.01, 0.07, 0.01, 0.01], 4) == pytest.approx([0, 0.05, 0.12, 0.15])


def test_a_long_halt_is_not_caught_up_with():
    begun = steps([0.01, 5.0, *[0.01] * 4], 6)
    assert begun == pytest.approx([0, 0.05, 5.05, 5.10, 5.15, 5.20])


def played(step: float, drawing: float, count: int) -> tuple[list[float], list[bytes], list[float]]:
    """Of a session whose steps and frames take so long: when steps begin, what is drawn, and when a step is told."""
    clock, begun, pictures, told = Clock(), [], [], []

    def tick() -> Snapshot:
        begun.append(clock.now - 100.0)
        clock.now += step
        return Snapshot({}, {"step": len(begun)}, (), pictures[-1] if pictures else b"")

    def draw() -> bytes:
        clock.now += drawing
        return str(len(begun)).encode()

    def publish(snapshot: Snapshot) -> None:
        if snapshot.state["step"] > len(told):
            told.append(clock.now - 100.0)
        if snapshot.picture not in (b"", *pictures[-1:]):
            pictures.append(snapshot.picture)

    session = SimpleNamespace(tick=tick, draw=draw)
    run(session, 20, publish, lambda: len(begun) == count, clock, clock.sleep)
    return begun, pictures, told


def test_every_step_is_drawn_where_there_is_time():
    begun, pictures, _ = played(0.01, 0.03, 40)
    assert begun == pytest.approx([0.05 * i for i in range(40)]) and len(pictures) == 40


def test_a_step_is_told_before_its_frame_is_drawn():
    begun, _, told = played(0.01, 0.03, 40)
    assert told == pytest.approx([begin + 0.01 for begin in begun])


def test_steps_go_before_pictures():
    begun, pictures, _ = played(0.03, 0.04, 60)
    # The first frame, of which nobody knows how long it takes, and every sixth one make a step late by 20 ms.
    late = [a for i, a in enumerate(begun) if a > 0.05 * i + 1e-6]
    assert len(late) <= 60 / (PATIENCE + 1) + 1 and max(a - 0.05 * i for i, a in enumerate(begun)) < 0.021
    assert len(pictures) == 60 / (PATIENCE + 1)
