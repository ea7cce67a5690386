"""Servoing a Panda's tool by a set-point, as Slalom and Keypad do."""

from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks.panda import PREFIX, InverseKinematics, import_mujoco

if TYPE_CHECKING:
    import mujoco


class SetPointControl:
    """Has the arm's servos follow a set-point of the tool's tip, the tool pointing down.

    Args:
        model: A compiled scene made by `panda.panda_scene`.
        data: What is simulated; the servos' angles are written there.
        workspace: Lowest and highest set-point (2, 3), metres.

    Attributes:
        set_point: Where the tip shall be (3,), metres.
        tip: Number of the tip's site in the model.
    """

    def __init__(self, model: "mujoco.MjModel", data: "mujoco.MjData", workspace: np.ndarray) -> None:
        self._mujoco = import_mujoco()
        self._model, self._data, self._workspace = model, data, workspace
        self._inverse_kinematics = InverseKinematics(model)
        self.tip = model.site(f"{PREFIX}tip").id

    def reset(self, set_point: np.ndarray, near: np.ndarray, *, iterations: int) -> None:
        """Begin an episode: the arm rests at the set-point, and everything else where the model has it.

        Args:
            set_point: (3,), metres.
            near: Joint angles (7,) in rad with the tip near it.
            iterations: Newton steps from there to the set-point; 0 where the tip is at it already.
        """
        self.set_point = set_point.copy()
        self._joints = self._inverse_kinematics.solve(set_point, near, iterations=iterations)
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:7] = self._joints
        self._data.ctrl[:] = self._joints
        self._mujoco.mj_forward(self._model, self._data)

    def move(self, delta: np.ndarray) -> None:
        """Move the set-point by (3,) metres, as far as the workspace goes, and the servos' angles with it."""
        self.set_point = np.clip(self.set_point + delta, *self._workspace)
        self._joints = self._inverse_kinematics.solve(self.set_point, self._joints, iterations=3)
        self._data.ctrl[:] = self._joints
