"""Slalom's geometry, corridors and MuJoCo models.

The geometry is that of D3IL's "avoiding" task: a Panda holds a rod before three rows of pillars and must reach the
line behind them through one gap of each row. Everything is in metres, in the robot's base frame.
"""

import itertools
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks import rendering
from lerobot_gloves.tasks.panda import HOME, InverseKinematics, import_mujoco, panda_scene
from lerobot_gloves.tasks.rendering import add_camera, add_surroundings

if TYPE_CHECKING:
    import mujoco

START = np.array([0.525, -0.28])
GOAL_Y = 0.35
ROW_Y = (-0.10, 0.08, 0.26)
PILLARS = np.array([[0.5, -0.10], [0.425, 0.08], [0.575, 0.08], [0.35, 0.26], [0.5, 0.26], [0.65, 0.26]])
"""Centres (6, 2) of the pillars, row by row."""
PILLAR_RADII = np.array([0.03, 0.025, 0.025, 0.025, 0.025, 0.025])
ROD_RADIUS, ROD_LENGTH, TIP_HEIGHT, PILLAR_HEIGHT = 0.01, 0.20, 0.03, 0.16  # the hand passes above the pillars
WORKSPACE = np.array([[0.2, -0.35], [0.8, 0.42]])
"""Lowest and highest (x, y) of the set-point."""
CAMERA = "front"

GAPS = (2, 3, 4)
MODES = tuple(" ".join(map(str, gaps)) for gaps in itertools.product(*map(range, GAPS)))
"""The 24 corridors: "i j k" passes gap i of the first row, j of the second, k of the third, counted from small x."""


def mode_of(seed: int) -> str:
    """The corridor of an episode: 24 consecutive seeds visit all."""
    return MODES[seed % len(MODES)]


def parse_mode(mode: str) -> tuple[int, int, int]:
    """The gaps of a corridor such as "0 2 3".

    Raises:
        ValueError: If it is not one of `MODES`.
    """
    if mode not in MODES:
        raise ValueError(f"Slalom has no corridor {mode!r}: give three gaps as in '0 2 3', from 0-1, 0-2 and 0-3")
    first, second, third = map(int, mode.split())
    return first, second, third


def gap_of(row: int, x: float) -> int:
    """Which gap of a row (0-2) the coordinate x lies in."""
    return int(np.searchsorted(PILLARS[PILLARS[:, 1] == ROW_Y[row], 0], x))


def nearest_pillar(xy: np.ndarray) -> tuple[float, np.ndarray]:
    """Free distance between the rod, centred at xy (2,), and the nearest pillar; the direction (2,) away from it."""
    offsets = xy - PILLARS
    rooms = np.linalg.norm(offsets, axis=1) - PILLAR_RADII - ROD_RADIUS
    nearest = int(rooms.argmin())
    return float(rooms[nearest]), offsets[nearest] / np.linalg.norm(offsets[nearest])


@cache
def model(*, visual: bool = False) -> "mujoco.MjModel":
    """The compiled scene, one a process: without meshes to move in, with them to draw from."""
    mujoco = import_mujoco("slalom")
    scene = panda_scene(rod_length=ROD_LENGTH, rod_radius=ROD_RADIUS, visual=visual, extra="slalom")
    for (x, y), radius in zip(PILLARS, PILLAR_RADII, strict=True):
        scene.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, PILLAR_HEIGHT / 2, 0],
            pos=[x, y, PILLAR_HEIGHT / 2],
            rgba=[0.85, 0.15, 0.12, 1],
            contype=0,
            conaffinity=1,
        )
    if visual:
        _decorate(scene, mujoco)
    return scene.compile()


def _decorate(scene: "mujoco.MjSpec", mujoco: ModuleType) -> None:
    """Add what only pictures need: surroundings, lines, camera."""
    add_surroundings(scene)
    for half_size, position, colour in (
        ([0.32, 0.008, 0.001], [0.5, GOAL_Y, 0.001], [0.10, 0.70, 0.22, 1]),
        ([0.32, 0.004, 0.001], [0.5, START[1], 0.001], [0.25, 0.35, 0.85, 1]),
    ):
        scene.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=half_size, pos=position, rgba=colour, contype=0, conaffinity=0
        )
    add_camera(scene.worldbody, CAMERA, position=[1.05, 0, 1.2], target=[0.55, 0, 1.2 - 0.866], up=[0, 0, 1], fovy=45)


@cache
def start_joints() -> np.ndarray:
    """Joint angles (7,) in rad with the rod's tip at `START`."""
    return InverseKinematics(model()).solve(np.array([*START, TIP_HEIGHT]), HOME, iterations=300)


def draw(joint_positions: np.ndarray, size: int) -> np.ndarray:
    """A frame (size, size, 3), uint8 RGB, of the scene at joint angles (7,) in rad."""
    return rendering.draw(model(visual=True), joint_positions, CAMERA, size)
