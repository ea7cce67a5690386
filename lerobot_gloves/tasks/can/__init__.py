"""CAN: a can into the requested quadrant of a bin, on robosuite's models."""

import gymnasium as gym

from lerobot_gloves.tasks.can.configuration import CanEnv

__all__ = ["CanEnv"]

gym.register("gloves/Can-v0", entry_point="lerobot_gloves.tasks.can.environment:Can")
