"""The simulated tasks; importing this makes them known to Gymnasium and LeRobot, and loads no simulator."""

from lerobot_gloves.tasks import can, keypad, slalom

__all__ = ["can", "keypad", "slalom"]
