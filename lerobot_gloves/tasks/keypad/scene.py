"""Keypad's geometry, codes and MuJoCo models.

A Panda holds a stylus, pointing down, above nine buttons that lie in the wells of a frame. Everything is in metres, in
the robot's base frame; z is the height of the stylus's tip.
"""

import itertools
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from lerobot_gloves.tasks import rendering
from lerobot_gloves.tasks.panda import HOME, PREFIX, InverseKinematics, import_mujoco, panda_scene
from lerobot_gloves.tasks.rendering import add_camera, add_surroundings

if TYPE_CHECKING:
    import mujoco

CENTRE, PITCH = np.array([0.5, 0.0]), 0.05
BUTTONS = np.array([CENTRE + PITCH * np.array([row, column]) for row in (-1, 0, 1) for column in (-1, 0, 1)])
"""Centres (9, 2), numbered row by row as the third-person camera, which faces the robot, sees them."""
BUTTON_HALF, BUTTON_TOP, TRAVEL = 0.016, 0.040, 0.008
PRESS, REARM = 0.005, 0.002
"""Travel at which a button fires, and below which it can fire again."""
FRAME_TOP, BAR_HALF, PLATE_TOP = 0.046, 0.004, 0.020
STYLUS_RADIUS, STYLUS_LENGTH = 0.005, 0.20  # long enough for the hand to hide no button from the third person
START = np.array([*CENTRE, 0.09])
FLOOR = BUTTON_TOP - TRAVEL - 0.002
"""Lowest set-point, 2 mm below a fully pressed button: pushing on after a press does no harm."""
WORKSPACE = np.array([[*CENTRE - 0.12, FLOOR], [*CENTRE + 0.12, 0.15]])
"""Lowest and highest (x, y, z) of the set-point."""
CAMERAS = ("third_person", "wrist")

DIGITS = 3
PRESSES = tuple(map(str, range(len(BUTTONS))))
CODES = tuple(" ".join(digits) for digits in itertools.product(PRESSES, repeat=DIGITS))
"""The 729 codes, such as "4 0 8"."""
EPISODES = {"code": CODES, "press": PRESSES}
"""What an episode can be, and what it can ask for."""


def code_of(seed: int) -> str:
    """The code of an episode: 729 consecutive seeds visit all, and few of them already very different ones."""
    return CODES[seed * 451 % len(CODES)]  # 729 over the golden ratio, and without a common divisor with 729


def check_mode(episode: str, mode: str | None) -> None:
    """Refuse an unknown kind of episode, or what it cannot ask for; None leaves that to the seed.

    Raises:
        ValueError: If there is no such episode, or no such code or button.
    """
    if episode not in EPISODES:
        raise ValueError(f"Keypad has no episode {episode!r}: choose one of {', '.join(EPISODES)}")
    if mode is not None and mode not in EPISODES[episode]:
        valid = "three buttons as in '4 0 8'" if episode == "code" else "one button as in '4'"
        raise ValueError(f"Keypad has no {episode} {mode!r}: give {valid}, from 0 to {len(BUTTONS) - 1}")


@cache
def model(*, visual: bool = False) -> "mujoco.MjModel":
    """The compiled scene, one a process: without meshes to move in, with them to draw from.

    The buttons are the only joints besides the arm's: qpos is 7 angles in rad and 9 travels.
    """
    mujoco = import_mujoco("keypad")
    scene = panda_scene(rod_length=STYLUS_LENGTH, rod_radius=STYLUS_RADIUS, visual=visual, extra="keypad")
    # With a round end: MuJoCo knows a capsule's contacts with a box in closed form. Those of a cylinder that stands on
    # a box it searches for, and now and then a wrong one throws the stylus sideways.
    stylus = scene.geom(f"{PREFIX}rod")
    stylus.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    stylus.size = [STYLUS_RADIUS, STYLUS_LENGTH / 2 - STYLUS_RADIUS, 0]
    stylus.rgba = [0.15, 0.45, 0.95, 1]
    _add_frame(scene, mujoco)
    for button in range(len(BUTTONS)):
        _add_button(scene, mujoco, button)
    if visual:
        _decorate(scene, mujoco)
    return scene.compile()


def _add_frame(scene: "mujoco.MjSpec", mujoco: ModuleType) -> None:
    """Add the plate below and the bars between the buttons, which the stylus must not touch."""
    half = 1.5 * PITCH + BAR_HALF
    height = (FRAME_TOP - PLATE_TOP) / 2
    boxes = [([half, half, PLATE_TOP / 2], [*CENTRE, PLATE_TOP / 2])]
    for offset in PITCH * np.array([-1.5, -0.5, 0.5, 1.5]):
        boxes.append(([half, BAR_HALF, height], [CENTRE[0], CENTRE[1] + offset, PLATE_TOP + height]))
        boxes.append(([BAR_HALF, half, height], [CENTRE[0] + offset, CENTRE[1], PLATE_TOP + height]))
    for half_size, position in boxes:
        scene.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=half_size,
            pos=position,
            rgba=[0.22, 0.24, 0.28, 1],
            contype=0,
            conaffinity=1,
        )


def _add_button(scene: "mujoco.MjSpec", mujoco: ModuleType, number: int) -> None:
    """Add a button: a body, its joint and its geom, all named like "button4"."""
    name = f"button{number}"
    button = scene.worldbody.add_body(name=name, pos=[*BUTTONS[number], BUTTON_TOP], gravcomp=1.0)
    # At rest without any force, as a limit that holds a button up would cost time in every substep: only the stop
    # below is one. Overdamped, so that a button does not swing when it is let go.
    stiff = {"solref": [0.004, 1.0], "solimp": [0.99, 0.999, 0.0005, 0.5, 2.0]}  # or the servos push through the stop
    button.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, -1],
        limited=True,
        range=[-0.01, TRAVEL],
        stiffness=np.array([150.0, 0.0, 0.0]),
        damping=np.array([5.0, 0.0, 0.0]),
        armature=0.01,
        **{f"{key}_limit": value for key, value in stiff.items()},
    )
    button.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[BUTTON_HALF, BUTTON_HALF, 0.006],
        pos=[0, 0, -0.006],
        mass=0.02,
        contype=0,
        conaffinity=1,
        condim=1,  # without friction: one row for the solver instead of three
        priority=1,  # what is said here holds, not what the stylus says
        **stiff,
    )


def _decorate(scene: "mujoco.MjSpec", mujoco: ModuleType) -> None:
    """Add what only pictures need: surroundings, the buttons' materials, cameras."""
    add_surroundings(scene)
    scene.add_material(name="unlit", rgba=[0.80, 0.80, 0.78, 1])
    scene.add_material(name="lit", rgba=[1.0, 0.55, 0.05, 1], emission=0.6)
    add_camera(scene.worldbody, CAMERAS[0], position=[0.98, 0, 0.50], target=[0.5, 0, 0.06], up=[0, 0, 1], fovy=19)
    # In the hand's frame z leads along the stylus, and x away from the robot.
    add_camera(
        scene.body(f"{PREFIX}right_hand"),
        CAMERAS[1],
        position=[0.07, 0, 0.02],
        target=[0.015, 0, STYLUS_LENGTH],
        up=[1, 0, 0],
        fovy=52,
    )


@cache
def start_joints() -> np.ndarray:
    """Joint angles (7,) in rad with the stylus's tip at `START`."""
    return InverseKinematics(model()).solve(START, HOME, iterations=300)


def draw(joint_positions: np.ndarray, lights: np.ndarray, camera: str, size: int) -> np.ndarray:
    """A frame of the scene.

    Args:
        joint_positions: Angles (7,) in rad and travels (9,) in metres.
        lights: (9,) True where a button is lit.
        camera: One of `CAMERAS`.
        size: Height and width in pixels.

    Returns:
        (size, size, 3), uint8 RGB.
    """
    materials = {f"button{i}": "lit" if lit else "unlit" for i, lit in enumerate(lights)}
    return rendering.draw(model(visual=True), joint_positions, camera, size, materials)
