"""The Franka Panda in plain MuJoCo: position servos, a rod in its hand, inverse kinematics.

The arm's MJCF and meshes are read from the installed robosuite wheel, which is located but never imported.
"""

import ctypes.util
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks.rendering import decimate_visual_meshes

if TYPE_CHECKING:
    import mujoco

OLDEST_MUJOCO, FIRST_UNUSABLE_MUJOCO = (3, 8, 1), (3, 10)
EVERY_TASK = "all"
"""The extra that installs what every task needs."""
JOINTS = tuple(f"joint{i}" for i in range(1, 8))
SERVO_STIFFNESS = (4000.0, 4000.0, 3500.0, 3500.0, 2000.0, 2000.0, 1000.0)  # N m / rad
PREFIX = "panda/"
HOME = np.array([0.0, np.pi / 16, 0.0, -5 * np.pi / 6, 0.0, np.pi - 0.2, np.pi / 4])
"""A comfortable posture (rad) that inverse kinematics starts from and stays close to."""


class SimulatorError(ImportError):
    """The simulator that a task needs is missing, too old or too new."""


def import_mujoco(extra: str = EVERY_TASK) -> ModuleType:
    """Import MuJoCo and check it, choosing headless EGL rendering unless `MUJOCO_GL` says otherwise.

    Args:
        extra: The extra of this package that installs what the task needs, for the error.

    Raises:
        SimulatorError: If MuJoCo is missing, of an unusable version, or cannot load its OpenGL library.
    """
    # MuJoCo reads MUJOCO_GL once, while it is imported; asked for EGL where there is none, that import fails.
    if sys.platform == "linux" and "MUJOCO_GL" not in os.environ and ctypes.util.find_library("EGL"):
        os.environ["MUJOCO_GL"] = "egl"
    if importlib.util.find_spec("mujoco") is None:
        raise SimulatorError(f"MuJoCo is not installed: {_install(extra)}")
    try:
        import mujoco
    except Exception as error:
        wanted = os.environ.get("MUJOCO_GL")
        raise SimulatorError(
            f"MuJoCo cannot load its OpenGL library with MUJOCO_GL={wanted}: install it (on Debian and Ubuntu "
            f"`apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0`) or unset MUJOCO_GL ({error})"
        ) from error
    version = tuple(int(part) for part in mujoco.__version__.split(".")[:3])
    if not OLDEST_MUJOCO <= version < FIRST_UNUSABLE_MUJOCO:
        raise SimulatorError(
            f"MuJoCo {mujoco.__version__} is installed, but 3.8.1 <= version < 3.10 is needed: {_install(extra)}"
        )
    return mujoco


def arm_file(extra: str = EVERY_TASK) -> Path:
    """Where the installed robosuite keeps its Panda.

    Args:
        extra: As of `import_mujoco`.

    Raises:
        SimulatorError: If robosuite is not installed.
    """
    package = importlib.util.find_spec("robosuite")
    if package is None or not package.submodule_search_locations:
        raise SimulatorError(f"robosuite, whose Panda this task uses, is not installed: {_install(extra)}")
    return Path(package.submodule_search_locations[0]) / "models/assets/robots/panda/robot.xml"


def _install(extra: str) -> str:
    return f"pip install 'lerobot_policy_gloves[{extra}]'"


def panda_scene(*, rod_length: float, rod_radius: float, visual: bool, extra: str = EVERY_TASK) -> "mujoco.MjSpec":
    """A scene with a Panda at the origin that holds a rod, tip site `panda/tip` at the rod's end.

    The rod is the arm's only colliding part (contype 1, conaffinity 0): give whatever it may touch conaffinity 1.

    Args:
        rod_length: From the flange to the tip, in metres.
        rod_radius: In metres.
        visual: With the arm's meshes, decimated, to draw pictures from. Without them the scene moves exactly alike
            and compiles in a millisecond, since all inertias are written in the MJCF.
        extra: As of `import_mujoco`.

    Returns:
        A `mujoco.MjSpec` to add the task's own bodies to; actuator i drives joint i to an angle in rad.
    """
    mujoco = import_mujoco(extra)
    path = arm_file(extra)
    arm = mujoco.MjSpec.from_file(str(path))
    for actuator in list(arm.actuators):
        arm.delete(actuator)
    for geom in list(arm.geoms):
        if geom.group == 0 or not visual:
            arm.delete(geom)
    for mesh in list(arm.meshes):
        if not visual or "_vis" not in mesh.name:
            arm.delete(mesh)
    if visual:
        decimate_visual_meshes(arm, path.parent, extra)
    for body in arm.bodies:
        body.gravcomp = 1.0
    for joint in arm.joints:
        joint.armature = 0.1
        joint.damping = np.array([1.0, 0.0, 0.0])
    hand = arm.body("right_hand")
    hand.add_geom(
        name="flange",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.03, 0.012, 0],
        pos=[0, 0, 0.012],
        rgba=[0.3, 0.3, 0.3, 1],
        contype=0,
        conaffinity=0,
        mass=0.05,
    )
    hand.add_geom(
        name="rod",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[rod_radius, rod_length / 2, 0],
        pos=[0, 0, rod_length / 2],
        rgba=[0.15, 0.15, 0.18, 1],
        contype=1,
        conaffinity=0,
        mass=0.05,
    )
    hand.add_site(name="tip", pos=[0, 0, rod_length], size=[0.001, 0, 0], rgba=[0, 0, 0, 0])
    for joint_name, stiffness in zip(JOINTS, SERVO_STIFFNESS, strict=True):
        servo = arm.add_actuator(name=joint_name, target=joint_name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=stiffness, kv=2 * np.sqrt(stiffness))

    scene = mujoco.MjSpec()
    scene.compiler.degree = False
    scene.option.timestep = 0.002
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.worldbody.add_frame().attach_body(arm.body("base"), PREFIX, "")
    return scene


class InverseKinematics:
    """Damped-least-squares inverse kinematics of the tool tip, on a scratch copy of the state.

    Args:
        model: A compiled scene made by `panda_scene`.
        damping: Added to the diagonal of J J^T.
        posture_gain: Share of the way back to the posture `HOME` that one iteration goes in the null space.
    """

    def __init__(self, model: "mujoco.MjModel", *, damping: float = 1e-3, posture_gain: float = 0.02) -> None:
        self._mujoco = import_mujoco()
        self._model = model
        self._scratch = self._mujoco.MjData(model)
        self._tip = model.site(f"{PREFIX}tip").id
        self._damping = damping * np.eye(6)
        self._posture_gain = posture_gain
        # The arm is the scene's first and only source of degrees of freedom that the inverse may use.
        self._range = np.array([model.joint(f"{PREFIX}{name}").range for name in JOINTS])
        self._jacobian = np.zeros((6, model.nv))

    def solve(self, position: np.ndarray, start: np.ndarray, *, iterations: int) -> np.ndarray:
        """Joint angles (7,) in rad that bring the tip to a position (3,) in metres with the tool pointing down.

        Args:
            position: Wanted tip position in the base frame.
            start: Joint angles (7,) to start from: along a path, the last solution.
            iterations: Newton steps; 3 are enough from one control step to the next.
        """
        mujoco, model, data, jacobian = self._mujoco, self._model, self._scratch, self._jacobian
        q = start.copy()
        for _ in range(iterations):
            data.qpos[:7] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], self._tip)
            tool = data.site_xmat[self._tip].reshape(3, 3)
            # Half the sum of the axes' cross products with those of a tool that points down, (x, -y, -z); np.cross is
            # ten times slower.
            rotation = 0.5 * np.array([tool[2, 1] - tool[1, 2], tool[2, 0] + tool[0, 2], -tool[1, 0] - tool[0, 1]])
            error = np.concatenate([position - data.site_xpos[self._tip], rotation])
            arm = jacobian[:, :7]
            square = arm @ arm.T + self._damping
            posture = self._posture_gain * (HOME - q)
            q = q + arm.T @ np.linalg.solve(square, error - arm @ posture) + posture
            q = np.clip(q, self._range[:, 0], self._range[:, 1])
        return q
