"""Keypad: a stylus enters three-digit codes on nine buttons, 729 codes."""

import gymnasium as gym

from lerobot_gloves.tasks.keypad.configuration import KeypadEnv

__all__ = ["KeypadEnv"]

gym.register("gloves/Keypad-v0", entry_point="lerobot_gloves.tasks.keypad.environment:Keypad")
