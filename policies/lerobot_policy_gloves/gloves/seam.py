"""`--policy.path=AGENT --policy.wrap=gloves` in every LeRobot command that loads a policy."""

import json
import sys
from collections.abc import Collection
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any

import draccus
import yaml
from draccus.utils import ParsingError
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.system.errors import cause, one_line

WRAP = "wrap"


def install() -> None:
    """Teach `PreTrainedConfig.from_pretrained` the option `--policy.wrap`; the second time changes nothing.

    LeRobot hands it the agent's path and the `--policy.*` options of the command line. With `--wrap` among them, the
    wrapper's configuration comes back, and what is not an option of the wrapper overrides the agent's.
    """
    original = PreTrainedConfig.__dict__["from_pretrained"].__func__
    if hasattr(original, "__wrapped__"):
        return

    @wraps(original)
    def from_pretrained(cls: type, pretrained_name_or_path: str | Path, **kwargs: Any) -> PreTrainedConfig:
        overrides = list(kwargs.get("cli_overrides") or [])
        wrap, overrides = split_options(overrides, {WRAP})
        if not wrap:
            return original(cls, pretrained_name_or_path, **kwargs)
        name = _value(wrap)
        if name != "gloves":
            sys.exit(f"unknown --policy.wrap={name}: the only wrapper is gloves")
        wrapper = PreTrainedConfig.get_choice_class(name)
        own = {field.name for field in fields(wrapper)} - {field.name for field in fields(PreTrainedConfig)}
        pinned, overrides = split_options(overrides, {"pretrained_revision"})
        mine, agents = split_options(overrides, own)
        # What both have, such as a seed, is the wrapper's; this option still reaches the agent's.
        shared, mine = split_options(mine, {"agent_overrides"})
        mine.append(f"--agent={pretrained_name_or_path}")
        revision = kwargs.get("revision") or _value(pinned)
        if revision:
            mine.append(f"--agent_revision={revision}")
        mine.append(f"--agent_overrides={json.dumps(agents + _listed(_value(shared) or '[]'))}")
        try:
            with draccus.config_type("json"):
                return draccus.parse(wrapper, args=mine)
        except ParsingError as error:
            told = one_line(cause(error))
            if "unrecognized arguments" in told:
                told += f"; or from the wrapper's own, {', '.join(f'--{option}' for option in sorted(own))}"
            # As draccus ends a program whose options it does not understand. As an exception this would come out of
            # the parser as "couldn't instantiate", at the end of its traceback.
            sys.exit(f"gloves: {told}")

    PreTrainedConfig.from_pretrained = classmethod(from_pretrained)


def _value(option: list[str]) -> str | None:
    """Value of `--name=value` or `--name value`, the last one if there are several; None if there is none."""
    last = option[-1] if option else None
    return last.partition("=")[2] if last is not None and last.startswith("--") else last


def _listed(told: str) -> list[str]:
    """The agent's options that are told as one value; ends the program if it is no list of them."""
    try:
        options = yaml.safe_load(told)
    except yaml.YAMLError:
        options = None
    if not isinstance(options, list):
        sys.exit(f"gloves: --policy.agent_overrides={told} is no list of options: write [--name=value]")
    return options


def split_options(arguments: list[str], names: Collection[str]) -> tuple[list[str], list[str]]:
    """Part `--name=value`, `--name value` and `--name.field=value` of the given names from all other options."""
    inside: list[str] = []
    outside: list[str] = []
    chosen = outside
    for argument in arguments:
        if argument.startswith("--"):
            name = argument[2:].split("=", 1)[0].split(".", 1)[0]
            chosen = inside if name in names else outside
        chosen.append(argument)
    return inside, outside
