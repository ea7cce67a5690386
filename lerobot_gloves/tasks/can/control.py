"""robosuite's OSC_POSE controller and Panda gripper, without robosuite's surroundings.

The law is that of `robosuite.controllers.parts.arm.osc` with its default settings (Khatib 1987, uncoupled), read from
MuJoCo directly: a control step takes a fraction of the time, and nothing but `OperationalSpaceControl` and
`mujoco.MjData` holds a state.
"""

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks.can.scene import ARM, FINGERS, GRIP_SITE
from lerobot_gloves.tasks.panda import import_mujoco

if TYPE_CHECKING:
    import mujoco

LARGEST_DELTA = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])
"""What an action of 1 means: metres for the position, rad for the orientation."""
STIFFNESS = 150.0
DAMPING = 2 * np.sqrt(STIFFNESS)
POSTURE_STIFFNESS = 10.0
POSTURE_DAMPING = 2 * np.sqrt(POSTURE_STIFFNESS)
FINGER_STEP = 0.2
"""Share of the half opening that one control step moves the fingers' set-point."""


class OperationalSpaceControl:
    """Moves the hand by position and orientation deltas, and the fingers at one speed open or closed.

    Args:
        model: The physics of `scene.model`.
        data: What is simulated; joint angles and controls are read and written there.
    """

    def __init__(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> None:
        self._mujoco, self._law = import_mujoco(), _compiled_law()
        self._model, self._data = model, data
        self._site = model.site(GRIP_SITE).id
        self._lowest, self._highest = model.actuator_ctrlrange[ARM].T
        self._finger_middle = model.actuator_ctrlrange[FINGERS].mean(axis=1)
        self._finger_reach = np.array([-1.0, 1.0]) * np.ptp(model.actuator_ctrlrange[FINGERS], axis=1) / 2
        self._jacobian = np.zeros((6, model.nv))
        self._inertia = np.zeros((model.nv, model.nv))
        # What is read and written in every physics step, looked up once: views that MuJoCo keeps current.
        self._angles, self._velocity, self._bias = data.qpos[ARM], data.qvel[ARM], data.qfrc_bias[ARM]
        self._torques = data.ctrl[ARM]
        self._place, self._axes = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)
        self.reset()

    def reset(self) -> None:
        """Begin an episode; the arm's joint angles become the posture it prefers."""
        self._posture = self._angles.copy()
        self._closing = 0.0  # -1 open, 1 closed

    def set_goal(self, action: np.ndarray) -> None:
        """Take an action (7,) in [-1, 1]: the goal lies that far from where the hand is now.

        The state's positions must be current (`mj_step1`).
        """
        delta = action[:6] * LARGEST_DELTA
        turn, rotation = np.zeros(4), np.zeros(9)
        angle = float(np.linalg.norm(delta[3:]))
        if angle > 0:
            self._mujoco.mju_axisAngle2Quat(turn, delta[3:] / angle, angle)
        else:
            turn[0] = 1.0
        self._mujoco.mju_quat2Mat(rotation, turn)
        self._goal = self._place + delta[:3]
        self._goal_axes = rotation.reshape(3, 3) @ self._axes
        self._closing = float(np.clip(self._closing + FINGER_STEP * np.sign(action[6]), -1.0, 1.0))
        self._data.ctrl[FINGERS] = self._finger_middle + self._closing * self._finger_reach

    def apply(self) -> None:
        """Write the arm's torques for one physics step, between `mj_step1` and `mj_step2`."""
        self._mujoco.mj_jacSite(self._model, self._data, self._jacobian[:3], self._jacobian[3:], self._site)
        self._mujoco.mj_fullM(self._model, self._inertia, self._data.qM)
        torques = self._law(
            self._jacobian,
            self._inertia,
            self._velocity,
            self._goal - self._place,
            self._goal_axes @ self._axes.T,
            self._posture - self._angles,
        )
        np.minimum(np.maximum(torques + self._bias, self._lowest), self._highest, out=self._torques)


def _torques(
    jacobian: np.ndarray,
    inertia: np.ndarray,
    velocity: np.ndarray,
    way: np.ndarray,
    turned: np.ndarray,
    bent: np.ndarray,
) -> np.ndarray:
    """The law itself: torques (7,) on top of what holds the robot against gravity.

    Args:
        jacobian: (6, joints) of the hand, translation above rotation.
        inertia: (joints, joints).
        velocity: (7,) of the arm's joints.
        way: (3,) from the hand to its goal.
        turned: (3, 3) rotation from the hand's axes to the goal's.
        bent: (7,) from the arm's joint angles to its posture's.

    Raises:
        numpy.linalg.LinAlgError: If a matrix is singular.
    """
    jacobian = np.ascontiguousarray(jacobian[:, :7])
    inertia = np.ascontiguousarray(inertia[:7, :7])
    error = np.empty(6)
    error[:3] = way
    # Half the sum of the axes' cross products with those of the goal.
    error[3] = 0.5 * (turned[2, 1] - turned[1, 2])
    error[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    error[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    wanted = STIFFNESS * error - DAMPING * (jacobian @ velocity)

    posture = POSTURE_STIFFNESS * bent - POSTURE_DAMPING * velocity
    mobility = jacobian @ np.linalg.solve(inertia, jacobian.T.copy())  # inverse of the inertia that the hand feels
    force = -np.linalg.solve(mobility, jacobian @ posture)  # what keeps the posture out of the hand's way
    force[:3] += np.linalg.solve(mobility[:3, :3].copy(), wanted[:3])
    force[3:] += np.linalg.solve(mobility[3:, 3:].copy(), wanted[3:])
    return jacobian.T @ force + inertia @ posture


@cache
def _compiled_law() -> Callable[..., np.ndarray]:
    """`_torques`, compiled: 25 times a control step, Python takes as long over it as MuJoCo over the physics."""
    from numba import njit  # the plugin loads without the extra, too

    return njit(cache=True)(_torques)
