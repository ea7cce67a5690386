"""Charger Plug's pictures, drawn by SAPIEN in a second ManiSkill scene that only shows what the first one says."""

import os
import warnings
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_gloves.tasks.charger.simulator import import_plug_charger, plug_charger

if TYPE_CHECKING:
    from lerobot_gloves.tasks.charger.scene import Scene

DRIVERS = (
    "NVIDIA's (libnvidia-gl), or Mesa newer than 22.3 (`apt-get install mesa-vulkan-drivers`, on Debian 12 with "
    "`-t bookworm-backports`), which draws without a GPU too"
)


@cache
def _device() -> str:
    """What draws, as ManiSkill calls it: the CUDA GPU, else what Vulkan calls a CPU; "" if neither can."""
    import_plug_charger()
    import sapien

    sapien.render.set_log_level("off")  # its own words take three lines
    for device in ("cuda", "cpu"):
        try:
            sapien.render.RenderSystem(sapien.Device(device))
        except RuntimeError:
            continue
        return device
    return ""


def missing_driver() -> str:
    """What is wrong, in one line, if SAPIEN finds no Vulkan driver that it can draw with; else ""."""
    return "" if _device() else f"drawing Charger's pictures needs a Vulkan driver that SAPIEN can use: {DRIVERS}"


@cache
def blank(size: int) -> np.ndarray:
    """A black frame (size, size, 3), uint8, in place of one that cannot be drawn; the first one says so."""
    warnings.warn(f"frames are black: {missing_driver()}", stacklevel=3)
    return np.zeros((size, size, 3), dtype=np.uint8)


def draw(scene: "Scene", camera: str, size: int) -> np.ndarray:
    """A frame (size, size, 3), uint8 RGB; the renderer is made at the first one of each size.

    Args:
        scene: What to show.
        camera: "wrist", the robot's own, or "third_person".
        size: Height and width in pixels.

    Raises:
        RuntimeError: If no Vulkan driver can draw it.
    """
    return _renderer(size, os.getpid())(scene, camera)


@cache
def _renderer(size: int, process: int) -> "_FrameRenderer":
    """One renderer a size and process: a Vulkan device does not survive a fork."""
    return _FrameRenderer(size)


class _FrameRenderer:
    """PlugCharger-v1 with materials and cameras, in which nothing moves by itself."""

    def __init__(self, size: int) -> None:
        if problem := missing_driver():
            raise RuntimeError(problem)
        frame = {"width": size, "height": size}
        self._env = plug_charger(
            obs_mode="rgb",
            render_mode="rgb_array",
            render_backend=_device(),
            sensor_configs=frame,
            human_render_camera_configs=frame,
        )
        sensors = {"wrist": self._env._sensors["hand_camera"]}
        self._cameras = {**sensors, "third_person": self._env._human_render_cameras["render_camera"]}

    def __call__(self, scene: "Scene", camera: str) -> np.ndarray:
        env: Any = self._env
        env.agent.robot._objs[0].qpos = scene.joint_positions
        env.charger._objs[0].pose = scene.charger
        env.receptacle._objs[0].pose = scene.receptacle
        env.scene.update_render(update_sensors=False, update_human_render_cameras=False)
        self._cameras[camera].capture()
        images = self._cameras[camera].get_obs(rgb=True, depth=False, position=False, segmentation=False)
        return images["rgb"][0].numpy()
