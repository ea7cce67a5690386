"""GLOVES for LeRobot, the library: the method, and the rooms that put it to work.

What the method is made of can be had from here as well as from its modules. It is loaded on first use, so that whoever
imports one room, such as the command, does not wait for torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "FEEG",
    "FPAS",
    "IFAE",
    "ConformalGate",
    "Laggy",
    "LikelihoodScore",
    "Noised",
    "Reference",
    "ResidualScore",
    "ReverseScore",
    "SelfNormalisedScore",
    "Shift",
    "Slow",
    "endpoint",
    "flow_matching_loss",
    "integrate",
    "interpolate",
]

if TYPE_CHECKING:
    from lerobot_gloves.conformal import ConformalGate
    from lerobot_gloves.editors import FEEG, FPAS, IFAE, Reference
    from lerobot_gloves.flow import endpoint, flow_matching_loss, integrate, interpolate
    from lerobot_gloves.perturbations import Laggy, Noised, Shift, Slow
    from lerobot_gloves.scores import LikelihoodScore, ResidualScore, ReverseScore, SelfNormalisedScore
else:

    def __getattr__(name: str) -> object:
        if name in __all__:
            for module in ("conformal", "editors", "flow", "perturbations", "scores"):
                found = vars(import_module(f"{__name__}.{module}"))
                if name in found:
                    return found[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
