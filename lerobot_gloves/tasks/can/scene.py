"""CAN's geometry, instructions and MuJoCo models.

The scene is that of robosuite's can placement: a Panda on a pedestal between a source bin, in which a can stands, and
a destination bin of four quadrants. The models are built by the installed robosuite. Everything is in metres, in the
world frame: x points away from the robot, y from the source bin to the destination bin.
"""

import logging
import warnings
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks import rendering
from lerobot_gloves.tasks.panda import SimulatorError, arm_file, import_mujoco
from lerobot_gloves.tasks.rendering import KEPT_FACES

if TYPE_CHECKING:
    import mujoco

SOURCE_BIN, DESTINATION_BIN = np.array([0.1, -0.25, 0.8]), np.array([0.1, 0.28, 0.8])
BIN_SIZE = np.array([0.39, 0.49])
"""Extent (x, y) of a bin up to the middle of its walls, as robosuite has it."""
WALL_TOP = 0.9
RESTING_HEIGHT = 0.8603
"""Height of the centre of a can that stands in a bin."""
CAN_SPREAD = np.array([0.12, 0.17])
"""Largest distance (x, y) of the can from the middle of the source bin at the start."""
HALF_OPEN = np.array([0.020833, -0.020833])
"""Joint positions (2,) of the fingers at the start."""
INITIAL_NOISE = 0.02
"""Standard deviation of the arm's joint angles around `panda.HOME` at the start, rad."""

ARM, FINGERS, CAN = slice(0, 7), slice(7, 9), slice(9, 16)
"""Where the joint positions of arm (rad), fingers (metres) and can (position, quaternion) are in qpos."""
CAN_VELOCITY = slice(9, 12)
"""Where the can's velocity (m/s) is in qvel."""
GRIP_SITE, HAND_BODY, CAN_BODY = "gripper0_right_grip_site", "gripper0_right_right_gripper", "Can_main"
CAMERAS = {"third_person": "agentview", "wrist": "robot0_eye_in_hand"}
"""Our names of the cameras, and robosuite's."""

KEPT_MESHES = ("Can", "gripper0_right_finger")
"""Beginnings of names of meshes that are not simplified: the can would lose its label, and the wrist sees fingers."""

QUADRANTS = ("top left", "top right", "bottom left", "bottom right")
"""As the third-person camera sees them: it looks at the robot, so top is small x (near the robot), left small y."""
MODES = tuple(f"Pick up the can and place it in the {name} of the destination bin." for name in QUADRANTS)


def parse_mode(mode: str) -> int:
    """Number of a quadrant (0-3) from its instruction or its name, such as "top left".

    Raises:
        ValueError: If it is neither.
    """
    names = MODES if mode in MODES else QUADRANTS
    if mode not in names:
        raise ValueError(f"CAN has no quadrant {mode!r}: choose one of {', '.join(QUADRANTS)}")
    return names.index(mode)


def quadrant_centre(quadrant: int) -> np.ndarray:
    """Centre (2,) of a quadrant (0-3) of the destination bin."""
    row, column = divmod(quadrant, 2)
    return DESTINATION_BIN[:2] + BIN_SIZE * [row - 0.5, column - 0.5] / 2


def quadrant_of(position: np.ndarray) -> int | None:
    """The quadrant (0-3) in which a can with its centre at (3,) lies; None if it is in none."""
    offset = position[:2] - DESTINATION_BIN[:2]
    height = position[2] - DESTINATION_BIN[2]
    if (np.abs(offset) >= BIN_SIZE / 2).any() or not 0 < height < WALL_TOP - DESTINATION_BIN[2]:
        return None
    return 2 * int(offset[0] > 0) + int(offset[1] > 0)


@cache
def _xml() -> str:
    """The scene's MJCF, put together by robosuite."""
    import_mujoco("can")
    arm_file("can")  # raises if there is no robosuite
    logger = logging.getLogger("robosuite_logs")
    logger.addFilter(_is_error)  # robosuite logs hints about its optional parts while it is imported
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from robosuite.models.arenas import BinsArena
            from robosuite.models.bases import robot_base_factory
            from robosuite.models.grippers import gripper_factory
            from robosuite.models.objects import CanObject
            from robosuite.models.robots import create_robot
            from robosuite.models.tasks import ManipulationTask
    except ImportError as error:
        raise SimulatorError(
            f"robosuite cannot be imported ({error}): pip install 'lerobot_policy_gloves[can]'"
        ) from error
    finally:
        logger.removeFilter(_is_error)
    robot = create_robot("Panda", idn=0)
    robot.add_base(robot_base_factory(robot.default_base, idn=0))
    robot.add_gripper(gripper_factory(robot.default_gripper["right"], idn="0_right"), robot.eef_name["right"])
    robot.set_base_xpos(robot.base_xpos_offset["bins"])
    arena = BinsArena(bin1_pos=SOURCE_BIN, table_full_size=(*BIN_SIZE, 0.82))
    arena.set_origin([0, 0, 0])
    task = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot], mujoco_objects=[CanObject(name="Can")])
    return task.get_xml()


def _is_error(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR


@cache
def model(*, visual: bool = False) -> "mujoco.MjModel":
    """The compiled scene, one a process: without visual parts to move in, with them to draw from."""
    mujoco = import_mujoco("can")
    scene = mujoco.MjSpec.from_string(_xml())
    # robosuite's group 0 collides, group 1 is seen, group 2 marks targets; inertias come from group 0 alone.
    shown = 1 if visual else 0
    for geom in list(scene.geoms):
        if geom.group != shown:
            scene.delete(geom)
    used = {geom.meshname for geom in scene.geoms}
    for mesh in list(scene.meshes):
        if mesh.name not in used:
            scene.delete(mesh)
    if visual:
        for site in list(scene.sites):
            site.group = 5  # not drawn; the hand's force sensors need theirs
        scene.compiler.inertiagrouprange = (1, 1)  # nothing moves here, but the compiler wants masses
        scene.visual.quality.offsamples = 0
        _decimate(scene)
    return scene.compile()


def _decimate(scene: "mujoco.MjSpec") -> None:
    """Simplify the meshes, which robosuite has in three file formats: MuJoCo reads them all."""
    try:
        import fast_simplification
    except ImportError as error:
        raise SimulatorError(
            "drawing pictures needs fast-simplification: pip install 'lerobot_policy_gloves[can]'"
        ) from error
    full = scene.copy().compile()  # a spec keeps what its own compilation read
    mujoco = import_mujoco("can")
    for mesh in scene.meshes:
        compiled = full.mesh(mesh.name)
        vertices = full.mesh_vert[compiled.vertadr[0] :][: compiled.vertnum[0]]
        faces = full.mesh_face[compiled.faceadr[0] :][: compiled.facenum[0]]
        if len(faces) < 200 or mesh.name.startswith(KEPT_MESHES):
            continue
        # The compiler has moved each mesh to its principal axes.
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, full.mesh_quat[compiled.id])
        vertices = vertices @ rotation.reshape(3, 3).T + full.mesh_pos[compiled.id]
        vertices, welded = np.unique(vertices.astype(np.float32).round(5), axis=0, return_inverse=True)
        faces = welded.ravel()[faces].astype(np.int32)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        vertices, faces = fast_simplification.simplify(vertices, faces, target_reduction=1 - KEPT_FACES)
        mesh.file = ""
        mesh.uservert = vertices.astype(np.float32).ravel()
        mesh.userface = faces.astype(np.int32).ravel()


def draw(joint_positions: np.ndarray, camera: str, size: int) -> np.ndarray:
    """A frame (size, size, 3), uint8 RGB, of the scene at qpos (16,) from one of `CAMERAS`."""
    return rendering.draw(model(visual=True), joint_positions, CAMERAS[camera], size)
