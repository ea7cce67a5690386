"""What is typed is read alike in every form: beside `--policy.wrap`, in the native one, in the `gloves` commands.

LeRobot's parser reads every value as YAML, and in places as JSON, before it knows what it is for: a checkpoint in a
folder named `007` becomes 7, one in `[a]` a list, the revision `12e4` a number. And no shell makes a home of the `~` in
`--dataset.root=~/data`. For the options of our own configurations what they are is declared, so it is looked up first.
"""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import wraps
from itertools import pairwise
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import draccus
import yaml
from draccus.choice_types import CHOICE_TYPE_KEY, ChoiceType
from lerobot.configs import parser

from lerobot_gloves.system.values import NOTHING, text_value

from .gloves.configuration_gloves import note_control_period

OURS = {
    "lerobot_gloves",
    "gloves_flow",
    "lerobot_policy_gloves",
    "lerobot_policy_csa_assist",
    "lerobot_policy_ddpm_assist",
}
"""Packages whose configurations' options are read so. LeRobot's own are read as it reads them, but for `~`."""


def install() -> None:
    """Teach LeRobot's parser to read our options so, and `--policy.path=~/...`; the second time changes nothing."""
    parse, get_path_arg = draccus.parse, parser.get_path_arg
    if hasattr(parse, "__wrapped__"):
        return

    @wraps(parse)
    def parse_as_declared(
        config_class: type, config_path: Any = None, args: Sequence[str] | None = None, **options: Any
    ) -> Any:
        path = None if config_path is None else os.path.expanduser(config_path)
        command: Any = parse(config_class, path, None if args is None else as_declared(config_class, args), **options)
        note_control_period(command)
        return command

    @wraps(get_path_arg)
    def get_path_arg_at_home(field_name: str, args: Sequence[str] | None = None) -> str | None:
        path = get_path_arg(field_name, args)
        return None if path is None else os.path.expanduser(path)

    draccus.parse = parse_as_declared  # type: ignore[assignment]
    parser.get_path_arg = get_path_arg_at_home


def as_declared(config_class: type, args: Sequence[str]) -> list[str]:
    """Command-line arguments with the values of our options in JSON, which means the same to every parser.

    Args:
        config_class: The configuration that they are for.
        args: `--name=value` and `--name value`.
    """
    read = list(args)
    for index, argument in enumerate(args):
        name, equals, value = argument.partition("=")
        if not name.startswith("--"):
            continue
        apart = index + 1 < len(args) and not args[index + 1].startswith("--")
        kinds = _declared(config_class, name[2:].split("."), args) if equals or apart else set()
        if not kinds:
            continue
        if equals:
            read[index] = f"{name}={_read(value, kinds)}"
        else:
            read[index + 1] = _read(args[index + 1], kinds)
    return read


def _declared(config_class: type, names: Sequence[str], args: Sequence[str]) -> set[Any]:
    """The types that the value of an option may have; none if the option is not ours."""
    kinds, ours = {config_class}, False
    for depth, name in enumerate(names):
        holder = next((kind for kind in kinds if is_dataclass(kind) or get_origin(kind) is dict), None)
        if holder is None:
            return set()
        if get_origin(holder) is dict:
            declared = get_args(holder)[1]
        elif name in {field.name for field in fields(holder)}:
            ours = ours or holder.__module__.partition(".")[0] in OURS
            declared = get_type_hints(holder)[name]
        else:
            return set()
        kinds = {_chosen(kind, names[: depth + 1], args) for kind in _alternatives(declared)}
    return kinds if ours else set()


def _alternatives(declared: Any) -> Iterator[Any]:
    yield from get_args(declared) if get_origin(declared) in (Union, UnionType) else [declared]


def _chosen(kind: Any, names: Sequence[str], args: Sequence[str]) -> Any:
    """The configuration that `--NAMES.type` chooses, if that is what the option is for."""
    if not (isinstance(kind, type) and issubclass(kind, ChoiceType)):
        return kind
    option = f"--{'.'.join(names)}.{CHOICE_TYPE_KEY}"
    chosen = [argument.partition("=")[2] for argument in args if argument.startswith(f"{option}=")]
    chosen += [value for argument, value in pairwise(args) if argument == option]
    return kind.get_known_choices().get(chosen[-1], kind) if chosen else kind


def _read(value: str, kinds: set[Any]) -> str:
    """A value as its types say: text, or YAML."""
    try:
        content = yaml.safe_load(value) if value else value
    except yaml.YAMLError:
        content = value
    if not kinds.isdisjoint({str, Path}):
        nothing = value in NOTHING and NoneType in kinds
        several = isinstance(content, list) and any(get_origin(kind) is list for kind in kinds)
        if not nothing and not several:
            content = text_value(value)
    elif isinstance(content, str):
        return content  # a word, or a number such as 1e5, which is none to YAML
    if isinstance(content, list) and not kinds.isdisjoint({list[str], list[Path]}):
        content = [os.path.expanduser(one) if isinstance(one, str) else one for one in content]
    try:
        return json.dumps(content, ensure_ascii=False)
    except TypeError:  # a date
        return value
