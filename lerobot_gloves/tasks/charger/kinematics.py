"""The Panda's differential inverse kinematics, by the Pinocchio that SAPIEN carries."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_gloves.tasks.charger.scene import TOOL_LINK
from lerobot_gloves.tasks.charger.simulator import import_plug_charger

HOME = np.array([0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4])
"""ManiSkill's rest posture (7,), rad, that the elbow is drawn to."""
DAMPING = 1e-4
POSTURE_GAIN = 0.05


@cache
def _model() -> Any:
    """Pinocchio's model of the robot, one a process."""
    import_plug_charger()  # quietly
    from mani_skill.agents.robots import PandaWristCam
    from sapien.wrapper.pinocchio_model import PinocchioModel

    model = PinocchioModel(Path(PandaWristCam.urdf_path).read_text(), [0, 0, -9.81])
    model.set_joint_order([*(f"panda_joint{i}" for i in range(1, 8)), "panda_finger_joint1", "panda_finger_joint2"])
    model.set_link_order([TOOL_LINK])
    return model


def joint_step(joint_positions: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """The joints' displacements (7,), rad, for a displacement of the tool, by damped least squares.

    Args:
        joint_positions: Arm and fingers (9,), rad and metres.
        twist: How the tool shall move (metres) and turn (rotation vector, rad), (6,), seen from the tool.
    """
    arm = _model().compute_single_link_local_jacobian(joint_positions, 0)[:, :7]
    posture = POSTURE_GAIN * (HOME - joint_positions[:7])
    square = arm @ arm.T + DAMPING * np.eye(6)
    return arm.T @ np.linalg.solve(square, twist - arm @ posture) + posture
