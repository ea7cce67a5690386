"""Pictures of MuJoCo's environments: right where several are drawn in one process, cheap, and none that nobody sees."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_gloves.tasks.environment import TaskEnvironment

FAST_SHADOWS = 1024
"""Width of the shadow map of fast rendering, in texels; MuJoCo's is 4096, which software fills for every frame."""


class Pictures:
    """Draws for one environment, in an OpenGL context of its own.

    Gymnasium's environments draw in the context that was made last, whosever it is: with the meshes of another scene.

    Attributes:
        wanted: Whether somebody looks; if not, the last frame is shown again.

    Args:
        env: A `MujocoEnv` that has drawn nothing.
        fast: Whether edges are drawn without multisampling, and shadows from a map of at most `FAST_SHADOWS`.
    """

    def __init__(self, env: Any, *, fast: bool):
        if fast:
            quality = env.model.vis.quality
            quality.offsamples, quality.shadowsize = 0, min(quality.shadowsize, FAST_SHADOWS)
        self.wanted = True
        self._viewers = env.mujoco_renderer._viewers
        self._draw, self._last = env.mujoco_renderer.render, None
        env.mujoco_renderer.render = self

    def __call__(self, *args: Any, **options: Any) -> Any:
        if self.wanted or self._last is None:
            self._enter()
            self._last = self._draw(*args, **options)
        return self._last

    def release(self) -> None:
        """Free what the context holds; the garbage collector would free the same names in another one's."""
        for viewer in self._enter():
            viewer.con.free()

    def _enter(self) -> list[Any]:
        viewers = list(self._viewers.values())
        for viewer in viewers:
            viewer.make_context_current()
        return viewers


def attend(envs: Sequence[gym.vector.SyncVectorEnv], *, fast: bool) -> list[Pictures]:
    """Have each of Gymnasium's MuJoCo environments in these batches drawn by `Pictures`."""
    inside = (_innermost(env) for batch in envs for env in batch.envs)
    return [Pictures(env, fast=fast) for env in inside if hasattr(env, "mujoco_renderer")]


def draw_only(env: gym.vector.SyncVectorEnv, rows: np.ndarray) -> None:
    """Say in which of B environments somebody will look at the next observation, bool (B,).

    The others show what they have shown, as far as they are drawn by `Pictures` or tasks of ours.
    """
    for one, wanted in zip(env.envs, rows, strict=True):
        inner = _innermost(one)
        drawn_by = getattr(getattr(inner, "mujoco_renderer", None), "render", inner)
        if isinstance(drawn_by, Pictures | TaskEnvironment):
            drawn_by.wanted = bool(wanted)


def _innermost(env: gym.Env) -> Any:
    """What LeRobot's environments of simulators made by others stand around; the environment itself if it is none."""
    outer: Any = env.unwrapped
    if hasattr(outer, "_ensure_env"):
        outer._ensure_env()  # else it is made by the first reset, which draws already
    inner = getattr(outer, "_env", outer)
    return getattr(inner, "unwrapped", inner)
