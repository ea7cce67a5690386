"""Slalom: a rod through three rows of pillars, 24 corridors."""

import gymnasium as gym

from lerobot_gloves.tasks.slalom.configuration import SlalomEnv

__all__ = ["SlalomEnv"]

gym.register("gloves/Slalom-v0", entry_point="lerobot_gloves.tasks.slalom.environment:Slalom")
