"""What pictures need: surroundings and cameras, and fast software rendering (decimated meshes, no shadows)."""

import atexit
import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

KEPT_FACES = 0.1
"""Share of a mesh's faces that is kept. Software rendering is bound by vertices: a tenth of them is 25 times faster."""


def decimate_visual_meshes(spec: "mujoco.MjSpec", folder: Path, extra: str) -> None:
    """Replace the OBJ meshes of a `mujoco.MjSpec` by simplified ones, in memory.

    Args:
        spec: Its meshes are files below `folder`.
        folder: Where the MJCF lies.
        extra: The extra of this package that installs what the task needs, for the error.

    Raises:
        ImportError: If fast-simplification is not installed.
    """
    try:
        import fast_simplification
    except ImportError as error:
        raise ImportError(
            f"drawing pictures needs fast-simplification: pip install 'lerobot_policy_gloves[{extra}]'"
        ) from error
    for mesh in spec.meshes:
        vertices, faces = _read_obj(folder / mesh.file)
        if len(faces) > 200:
            vertices, faces = fast_simplification.simplify(vertices, faces, target_reduction=1 - KEPT_FACES)
        mesh.file = ""
        mesh.uservert = vertices.astype(np.float32).ravel()
        mesh.userface = faces.astype(np.int32).ravel()


def _read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3), with the vertices that the file splits by normal welded together."""
    lines = path.read_text().splitlines()
    vertices = np.fromstring(" ".join(line[2:] for line in lines if line[:2] == "v "), sep=" ", dtype=np.float32)
    # Every face is a triangle, every corner "vertex/texture/normal", counted from 1.
    corners = " ".join(line[2:] for line in lines if line[:2] == "f ").replace("/", " ")
    faces = np.fromstring(corners, sep=" ", dtype=np.int32).reshape(-1, 3, 3)[:, :, 0] - 1
    vertices, welded = np.unique(vertices.reshape(-1, 3).round(5), axis=0, return_inverse=True)
    faces = welded.ravel()[faces].astype(np.int32)
    degenerate = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return vertices, faces[~degenerate]


def add_surroundings(scene: "mujoco.MjSpec") -> None:
    """Add what the pictures of every scene need and its physics does not: floor, light and sky."""
    import mujoco

    scene.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.9, 0.9, 0.02],
        pos=[0.45, 0.0, -0.021],
        rgba=[0.80, 0.75, 0.67, 1],
        contype=0,
        conaffinity=0,
    )
    scene.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0.5, 0, 2.5],
        dir=[-0.35, 0.25, -1],
        diffuse=[0.5, 0.5, 0.5],
        castshadow=False,
    )
    scene.visual.headlight.ambient = [0.35, 0.35, 0.35]
    scene.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    scene.visual.quality.offsamples = 0
    scene.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[0.85, 0.88, 0.92],
        rgb2=[0.85, 0.88, 0.92],
        width=16,
        height=96,
    )


def add_camera(
    body: "mujoco.MjsBody",
    name: str,
    *,
    position: Sequence[float],
    target: Sequence[float],
    up: Sequence[float],
    fovy: float,
) -> None:
    """Add a camera to a body of a `mujoco.MjSpec`.

    Args:
        body: The world, or what the camera shall move with.
        name: Its name.
        position: Where it is (3,), in the body's frame, metres.
        target: A point (3,) in the middle of its picture.
        up: Direction (3,) that points up in its picture; need not be orthogonal to the view.
        fovy: Vertical field of view, degrees.
    """
    import mujoco

    backward = np.subtract(position, target)  # a MuJoCo camera looks along its -z
    backward = backward / np.linalg.norm(backward)
    right = np.cross(up, backward)
    right = right / np.linalg.norm(right)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([right, np.cross(backward, right), backward], axis=1).ravel())
    body.add_camera(name=name, pos=position, quat=quaternion, fovy=fovy)


def draw(
    model: "mujoco.MjModel",
    joint_positions: np.ndarray,
    camera: str,
    size: int,
    materials: Mapping[str, str] | None = None,
) -> np.ndarray:
    """A frame (size, size, 3), uint8 RGB; the renderer is made at the first one of each model and size.

    Args:
        model: A compiled scene with visual meshes; the same object for every frame.
        joint_positions: qpos (nq,).
        camera: Name of a camera of the scene.
        size: Height and width in pixels.
        materials: What else than joints can differ between frames: the material of each geom that changes its look,
            by their names. Every call names the same geoms, as the model keeps what the last one gave them.
    """
    return _renderer(model, size, os.getpid())(joint_positions, camera, materials or {})


@cache
def _renderer(model: "mujoco.MjModel", size: int, process: int) -> "FrameRenderer":
    """One renderer a model, size and process: an OpenGL context does not survive a fork."""
    return FrameRenderer(model, size)


class FrameRenderer:
    """Draws square frames of a scene from its joint positions and the materials of its geoms alone.

    Making one opens an OpenGL context, so it must be made in the process that draws, never before a fork.

    Args:
        model: A compiled scene with visual meshes; its offscreen buffer is resized to the frame's size.
        size: Height and width in pixels.
    """

    def __init__(self, model: "mujoco.MjModel", size: int) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model = model
        self._data = mujoco.MjData(model)
        model.vis.global_.offwidth = model.vis.global_.offheight = size
        try:
            self._renderer = mujoco.Renderer(model, size, size)
        except Exception as error:
            raise RuntimeError(
                f"MuJoCo cannot open an OpenGL context ({error}): on a machine without a display set MUJOCO_GL=egl"
            ) from error
        atexit.register(self._renderer.close)  # left to the garbage collector it outlives the OpenGL library
        flags = self._renderer.scene.flags
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            flags[flag] = 0

    def __call__(self, joint_positions: np.ndarray, camera: str, materials: Mapping[str, str]) -> np.ndarray:
        """A frame (size, size, 3), uint8 RGB; the arguments are those of `draw`."""
        for geom, material in materials.items():
            self._model.geom(geom).matid = self._model.material(material).id
        self._data.qpos[:] = joint_positions
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, camera=camera)
        return self._renderer.render()
