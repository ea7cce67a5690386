"""`--policy.path=AGENT --policy.wrap=gloves` in every LeRobot command that loads a policy."""

import json
from collections.abc import Collection
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any

import draccus
from lerobot.configs import PreTrainedConfig

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
        name = wrap[-1].split("=", 1)[-1]
        if name != "gloves":
            raise ValueError(f"unknown --policy.wrap={name}: the only wrapper is gloves")
        wrapper = PreTrainedConfig.get_choice_class(name)
        own = {field.name for field in fields(wrapper)} - {field.name for field in fields(PreTrainedConfig)}
        mine, agents = split_options(overrides, own)
        mine.append(f"--agent={pretrained_name_or_path}")
        if kwargs.get("revision"):
            mine.append(f"--agent_revision={kwargs['revision']}")
        mine.append(f"--agent_overrides={json.dumps(agents)}")
        with draccus.config_type("json"):
            return draccus.parse(wrapper, args=mine)

    PreTrainedConfig.from_pretrained = classmethod(from_pretrained)


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
