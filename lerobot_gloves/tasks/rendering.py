"""Fast software rendering: decimated meshes, no shadows, one renderer a process."""

import atexit
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

KEPT_FACES = 0.1
"""Share of a mesh's faces that is kept. Software rendering is bound by vertices: a tenth of them is 25 times faster."""


def decimate_visual_meshes(spec: "mujoco.MjSpec", folder: Path) -> None:
    """Replace the OBJ meshes of a `mujoco.MjSpec` by simplified ones, in memory.

    Args:
        spec: Its meshes are files below `folder`.
        folder: Where the MJCF lies.

    Raises:
        ImportError: If fast-simplification is not installed.
    """
    try:
        import fast_simplification
    except ImportError as error:
        raise ImportError(
            "drawing pictures needs fast-simplification: pip install 'lerobot_policy_gloves[slalom]'"
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


class FrameRenderer:
    """Draws square frames of a scene from its joint positions alone.

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

    def __call__(self, joint_positions: np.ndarray, camera: str) -> np.ndarray:
        """A frame (size, size, 3), uint8 RGB.

        Args:
            joint_positions: qpos (nq,).
            camera: Name of a camera of the scene.
        """
        self._data.qpos[:] = joint_positions
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, camera=camera)
        return self._renderer.render()
