"""Write a score or an editor in one word of a command line, and read it back: `feeg:start=0.5,steps=10`."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

NONE = "none"
"""What a specification says where there is nothing: no perturbation, no editor."""


def parse(text: str, choices: Mapping[str, type], kind: str) -> Any:
    """Build the dataclass that a specification names.

    Args:
        text: `NAME` or `NAME:KEY=VALUE,KEY=VALUE`; what is left out has the dataclass's default.
        choices: The valid names and their dataclasses, whose fields are numbers.
        kind: What is being named ("method", "score"), for the error.

    Returns:
        An instance of the dataclass.

    Raises:
        ValueError: If the name, a key or a value is not valid; the message lists the valid ones.
    """
    name, _, rest = text.partition(":")
    if name not in choices:
        raise ValueError(f"unknown {kind} {name!r}: choose from {', '.join(sorted(choices))}")
    types: dict[str, Any] = {field.name: type(field.default) for field in fields(choices[name])}
    values = {}
    for item in filter(None, rest.split(",")):
        key, _, value = item.partition("=")
        if key in values:
            raise ValueError(f"{kind} {name!r}: {key} is there twice")
        if key not in types:
            raise ValueError(f"{kind} {name!r} has no option {key!r}: choose from {', '.join(types) or 'none'}")
        try:
            values[key] = types[key](value)
        except ValueError:
            message = f"{kind} {name!r}: {key}={value!r} is not a number of type {types[key].__name__}"
            raise ValueError(message) from None
        if not math.isfinite(values[key]):
            raise ValueError(f"{kind} {name!r}: {key}={value!r} is not finite")
    return choices[name](**values)


@dataclass(frozen=True)
class _Nothing:
    """What `none` stands for: it has no options."""


def parse_optional(text: str, choices: Mapping[str, type], kind: str) -> Any:
    """The same where there may be nothing: None for `none`, which is a choice too."""
    found = parse(text, {NONE: _Nothing, **choices}, kind)
    return None if isinstance(found, _Nothing) else found


def specification(instance: Any, choices: Mapping[str, type]) -> str:
    """The specification that `parse_optional` turns back into `instance`, every option written out; `none` for None."""
    if instance is None:
        return NONE
    name = next(name for name, choice in choices.items() if choice is type(instance))
    options = ",".join(f"{field.name}={getattr(instance, field.name)}" for field in fields(instance))
    return f"{name}:{options}" if options else name


def parse_all(text: str, choices: Mapping[str, type], kind: str) -> tuple[Any, ...]:
    """The same where there may be several, joined by `+`."""
    return tuple(parse(part, choices, kind) for part in parts_of(text))


def parts_of(text: str) -> list[str]:
    """The specifications that `+` joins to a compound; a single specification is its own only part.

    A plus before a digit belongs to a number, as in `sigma=1e+3`.
    """
    return re.split(r"\+(?!\d)", text)


def name_of(text: str) -> str:
    """The name in a specification, without its options; a compound's is `noised+laggy`."""
    return "+".join(part.partition(":")[0] for part in parts_of(text))
