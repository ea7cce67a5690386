"""Perturbations that make a good agent imperfect (paper, appendix "Imitation Learning Policy with wrapper"), and more.

They act on raw action chunks (B, T, A), in the environment's units. Each environment draws from a generator of its
own, seeded by `reset`, so that what happens to it does not depend on the batch it runs in. The paper's are `Noised`,
`Laggy`, `Slow` and `Shift`.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from lerobot_gloves.perturbations.base import Perturbation
from lerobot_gloves.perturbations.compound import CHOICES, Compound, parse_perturbation, written_out
from lerobot_gloves.perturbations.dimensions import Chatter, Rotated, Shift
from lerobot_gloves.perturbations.noise import Noised, Smooth
from lerobot_gloves.perturbations.registry import PERTURBATIONS
from lerobot_gloves.perturbations.size import Deadzone, Quantised, Slow
from lerobot_gloves.perturbations.timing import Delayed, Dropped, Laggy

__all__ = [
    "CHOICES",
    "PERTURBATIONS",
    "Chatter",
    "Compound",
    "Deadzone",
    "Delayed",
    "Dropped",
    "Laggy",
    "Noised",
    "Perturbation",
    "Quantised",
    "Rotated",
    "Shift",
    "Slow",
    "Smooth",
    "parse_perturbation",
    "written_out",
]
