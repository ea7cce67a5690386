"""Charger Plug: a charger into a receptacle with half a millimetre to spare, on ManiSkill."""

import gymnasium as gym

from lerobot_gloves.tasks.charger.configuration import ChargerEnv

__all__ = ["ChargerEnv"]

gym.register("gloves/Charger-v0", entry_point="lerobot_gloves.tasks.charger.environment:Charger")
