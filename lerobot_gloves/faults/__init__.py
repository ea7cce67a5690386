"""Randomised agents: what may be wrong with whoever proposes, drawn anew for every item of a copilot's training.

A history (B, K, T, A) holds the chunks of K decisions of one episode, the oldest first, as the expert made them. An
agent is one draw for all of them: which faults it has and how strong they are, the same at every decision; what happens
by chance happens anew at each. Actions are normalised, so that strengths are in units of the data's spread.

The comments above their fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from lerobot_gloves.faults.agents import FAULTS, RandomisedAgents
from lerobot_gloves.faults.direction import Held, Rotated
from lerobot_gloves.faults.fault import CONSTANT, Fault, Range, Units
from lerobot_gloves.faults.noise import Drift, Noise
from lerobot_gloves.faults.person import PROMPT, Driven
from lerobot_gloves.faults.size import Chatter, DeadZone, Offset, Quantised, Scale
from lerobot_gloves.faults.timing import Delay, Dropped, Replay

__all__ = [
    "CONSTANT",
    "FAULTS",
    "PROMPT",
    "Chatter",
    "DeadZone",
    "Delay",
    "Drift",
    "Driven",
    "Dropped",
    "Fault",
    "Held",
    "Noise",
    "Offset",
    "Quantised",
    "RandomisedAgents",
    "Range",
    "Replay",
    "Rotated",
    "Scale",
    "Units",
]
