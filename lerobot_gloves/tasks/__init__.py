"""The simulated tasks; importing this makes them known to Gymnasium and LeRobot, and loads no simulator."""

from lerobot_gloves.tasks import can, charger, keypad, slalom

__all__ = ["can", "charger", "keypad", "slalom"]
