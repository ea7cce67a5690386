"""What a page may say, and what becomes of everything else."""

import json
import random

import pytest

from lerobot_gloves.drive.desk import PATIENCE, Desk
from lerobot_gloves.drive.protocol import LARGEST, Begin, Command, MessageError, Settings, Take, parse
from lerobot_gloves.drive.stick import CENTRE, Stick

SETTINGS = {"type": "settings", "assistance": "gate", "alpha": 0.05, "limit": 1, "fault": "none"}
VALID = {
    '{"type": "command", "x": -1, "y": 0.5}': Command(-1.0, 0.5),
    json.dumps(SETTINGS): Settings("gate", 0.05, 1.0, "none"),
    '{"type": "begin", "episode": "next"}': Begin("next"),
    '{"type": "take"}': Take(),
}


class Driven:
    """What a desk needs of a session."""

    def __init__(self):
        self.stick, self.asked = Stick(), []
        self.ask = self.asked.append


@pytest.mark.parametrize("text", VALID)
def test_what_the_page_sends_is_understood(text):
    assert parse(text) == VALID[text]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "must be JSON"),
        ("[]", "must be a JSON object"),
        ("[" * 900, "must be JSON"),
        ('{"type": "fly"}', "type must be one of command, settings, begin, take"),
        ('{"type": ["take"]}', "type must be one of"),
        ('{"type": "take", "by": 1}', "take has the fields of none"),
        ('{"type": "command", "x": 1}', "has the fields grip, x, y, z"),
        ('{"type": "command", "x": NaN, "y": 0}', "must hold finite numbers, not NaN"),
        ('{"type": "command", "x": -Infinity, "y": 0}', "not -Infinity"),
        ('{"type": "command", "x": 1e999, "y": 0}', "x must lie between -1 and 1"),
        ('{"type": "command", "x": 1.01, "y": 0}', "x must lie between -1 and 1"),
        ('{"type": "command", "x": %s, "y": 0}' % ("9" * 900), "x must lie between -1 and 1"),
        ('{"type": "command", "x": true, "y": 0}', "x must be a number"),
        ('{"type": "command", "x": "1", "y": 0}', "x must be a number"),
        (json.dumps(SETTINGS | {"alpha": 0}), "alpha must lie between 0.001 and 0.999"),
        (json.dumps(SETTINGS | {"assistance": "on"}), "assistance must be one of off, gate, always"),
        (json.dumps(SETTINGS | {"fault": None}), "fault must be a word"),
        ('{"type": "begin", "episode": "last"}', "episode must be one of again, next"),
        ("x" * (LARGEST + 1), f"a message has {LARGEST + 1} characters, but may have {LARGEST}"),
        (b"{}", "must be text"),
    ],
)
def test_all_else_is_refused_in_one_line(text, told):
    with pytest.raises(MessageError) as error:
        parse(text)
    assert told in str(error.value) and "\n" not in str(error.value) and len(str(error.value)) < 200


def mutated(rng: random.Random) -> str | bytes:
    """Something like a message: cut, with characters changed, or made of odd values."""
    text = rng.choice(list(VALID))
    match rng.randrange(5):
        case 0:
            return text[: rng.randrange(len(text) + 1)]
        case 1:
            place = rng.randrange(len(text))
            return text[:place] + chr(rng.randrange(1, 0xD7FF)) + text[place + 1 :]
        case 2:
            odd = [None, True, [], {}, "", -2, 1e308, 10**300, float("nan"), float("inf"), "x" * 2000, [[[]]] * 50]
            content = json.loads(text)
            content[rng.choice([*content, "type", "z"])] = rng.choice(odd)
            return json.dumps(content)
        case 3:
            return rng.randbytes(rng.randrange(60))
        case _:
            return rng.choice(['{"a":' * 150, "[" * 5000, "\x00", "9" * 5000, '"\\ud800"', text * 30])


def test_ten_thousand_wrong_messages_change_nothing_and_stop_the_robot():
    rng, driven = random.Random(0), Driven()
    desk = Desk(driven)
    refused = 0
    for _ in range(10_000):
        seat = desk.seats.driver or desk.seats.enter("a page")
        driven.stick.move(0.5, 0.5)
        before = seat.refused
        message = mutated(rng)
        stays = desk.receive(seat, message)
        assert len(seat.lines) <= 5 and all("\n" not in line for line in seat.lines)
        if seat.refused > before:
            refused += 1
            assert driven.stick.position == CENTRE
        else:
            assert parse(message)  # by chance it is still one
            assert all(-1 <= entry <= 1 for entry in driven.stick.position)
        assert stays == (seat.refused < PATIENCE)
        if not stays:
            desk.seats.leave(seat)
    assert 9000 < refused < 10_000
    assert all(isinstance(one, Settings | Begin) for one in driven.asked)


def test_a_watcher_cannot_drive_choose_or_begin():
    driven = Driven()
    desk = Desk(driven)
    driver, watcher = desk.seats.enter("one"), desk.seats.enter("two")
    desk.receive(driver, '{"type": "command", "x": 0.25, "y": 0}')
    for text in VALID:
        assert desk.receive(watcher, text)
    assert driven.stick.position == (0.25, 0.0, 0.0, 0.0) and driven.asked == [] and desk.seats.driver is driver
    assert set(watcher.lines) == {"only the page that drives may do that"} and watcher.refused == 3
