"""Options of the wrapper for its adapter that a method of the benchmark may have, such as `adapter_overrides`."""

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from lerobot.configs import PreTrainedConfig

from lerobot_gloves.benchmark.cell import PERTURBED
from lerobot_gloves.specification import name_of


def check_options(options: Mapping[str, Any]) -> None:
    """Refuse options for the adapter that the wrapper does not have, or that are of another form there.

    Raises:
        ValueError: If there are any; the message lists what is valid.
    """
    allowed = adapter_options()
    for name, value in options.items():
        if name not in allowed:
            raise ValueError(f"the wrapper has no adapter option {name!r}: choose from {', '.join(allowed)}")
        if name == "adapter_overrides" and not (isinstance(value, list) and all(isinstance(one, str) for one in value)):
            raise ValueError(f"adapter_overrides is {value!r}, but must be a list of options such as [--guidance=2]")
        if name == "adapter_rename_map" and not isinstance(value, dict):
            raise ValueError(f"adapter_rename_map is {value!r}, but must be observation keys by observation keys")


def adapter_options() -> list[str]:
    """The wrapper's options for its adapter that a benchmark leaves open."""
    names = [option.name for option in fields(PreTrainedConfig.get_choice_class("gloves"))]
    # A checkpoint counts by content: another revision is another checkpoint.
    return [name for name in names if name.startswith("adapter_") and name != "adapter_revision"] + ["alpha_of"]


def told_options(options: Mapping[str, Any], perturbation: str) -> dict[str, Any]:
    """The options under a perturbation, a specification, whose name takes the place of `PERTURBED`."""
    return json.loads(json.dumps(options).replace(PERTURBED, name_of(perturbation)))
