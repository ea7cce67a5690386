"""Networks: the DiT velocity field and the encoders of its context. They know torch, and nothing of LeRobot."""

from lerobot_gloves.networks.velocity import BoundVelocity, VelocityNetwork

__all__ = ["BoundVelocity", "VelocityNetwork"]
