"""What a page may say: small JSON objects, each checked whole before anything is done about it."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

LARGEST = 1000
"""Characters that a message may have; the longest that the page sends has some 120."""

type Assist = Literal["off", "gate", "always"]


class MessageError(ValueError):
    """A message that is not one; one line says what is wrong with it."""


@dataclass(frozen=True)
class Command:
    """Where the stick is, see `lerobot_gloves.drive.stick.Position`."""

    x: float
    y: float
    z: float = 0.0
    grip: float = 0.0


@dataclass(frozen=True)
class Settings:
    """How a person is helped.

    Attributes:
        assistance: `off`; `gate`, where chunks that look like the expert's pass; `always`.
        alpha: The gate's significance level, in (0, 1).
        limit: How far assistance may move an action, as a share of the largest action, entry by entry, in [0, 2]; 2
            turns any action into any other.
        fault: Name of the fault to drive against, `none` for none.
    """

    assistance: Assist
    alpha: float
    limit: float
    fault: str


@dataclass(frozen=True)
class Begin:
    """Begin an episode: the same `again`, or the `next` one."""

    episode: Literal["again", "next"]


@dataclass(frozen=True)
class Take:
    """A watcher takes the controls, which nobody has."""


type Message = Command | Settings | Begin | Take

FIELDS = {
    "command": {"x", "y", "z", "grip"},
    "settings": {"assistance", "alpha", "limit", "fault"},
    "begin": {"episode"},
    "take": set[str](),
}


def parse(text: str | bytes) -> Message:
    """Read a message.

    Raises:
        MessageError: If it is too long, no JSON object, or one with a field that is missing, unknown or out of range.
    """
    if isinstance(text, bytes):
        raise MessageError("a message must be text, not bytes")
    if len(text) > LARGEST:
        raise MessageError(f"a message has {len(text)} characters, but may have {LARGEST}")
    try:
        content = json.loads(text, parse_constant=_refuse)
    except MessageError:
        raise
    except (ValueError, RecursionError):  # a number of too many digits is a ValueError as well
        raise MessageError("a message must be JSON") from None
    if not isinstance(content, dict):
        raise MessageError("a message must be a JSON object")
    kind = content.pop("type", None)
    if not isinstance(kind, str) or kind not in FIELDS:
        raise MessageError(f"a message's type must be one of {', '.join(FIELDS)}")
    if kind == "command":  # of a task without height, or without fingers
        content = {"z": 0, "grip": 0, **content}
    if content.keys() != FIELDS[kind]:
        raise MessageError(f"a message of type {kind} has the fields {', '.join(sorted(FIELDS[kind])) or 'of none'}")
    match kind:
        case "command":
            return Command(*(_number(content, name, -1, 1) for name in ("x", "y", "z", "grip")))
        case "settings":
            return Settings(
                cast(Assist, _choice(content, "assistance", get_args(Assist.__value__))),
                _number(content, "alpha", 0.001, 0.999),
                _number(content, "limit", 0, 2),
                _word(content, "fault"),
            )
        case "begin":
            return Begin(cast(Literal["again", "next"], _choice(content, "episode", ("again", "next"))))
        case _:
            return Take()


def _refuse(constant: str) -> None:
    raise MessageError(f"a message must hold finite numbers, not {constant}")


def _number(content: Mapping[str, Any], name: str, low: float, high: float) -> float:
    value = content[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MessageError(f"{name} must be a number")
    if not (low <= value <= high and math.isfinite(value)):
        raise MessageError(f"{name} must lie between {low} and {high}")
    return float(value)


def _word(content: Mapping[str, Any], name: str) -> str:
    value = content[name]
    if not isinstance(value, str):
        raise MessageError(f"{name} must be a word")
    return value


def _choice(content: Mapping[str, Any], name: str, choices: tuple[str, ...]) -> str:
    value = _word(content, name)
    if value not in choices:
        raise MessageError(f"{name} must be one of {', '.join(choices)}")
    return value
