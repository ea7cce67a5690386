"""The perturbations by the name that a specification calls them."""

from lerobot_gloves.perturbations.base import Perturbation
from lerobot_gloves.perturbations.dimensions import Chatter, Rotated, Shift
from lerobot_gloves.perturbations.noise import Noised, Smooth
from lerobot_gloves.perturbations.size import Deadzone, Quantised, Slow
from lerobot_gloves.perturbations.timing import Delayed, Dropped, Laggy

PERTURBATIONS: dict[str, type[Perturbation]] = {
    "noised": Noised,
    "laggy": Laggy,
    "slow": Slow,
    "shift": Shift,
    "smooth": Smooth,
    "delayed": Delayed,
    "dropped": Dropped,
    "deadzone": Deadzone,
    "quantised": Quantised,
    "rotated": Rotated,
    "chatter": Chatter,
}
"""By name: the paper's four first. Several of them one after the other are a `Compound`."""
