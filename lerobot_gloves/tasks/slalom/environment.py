"""Slalom as a Gymnasium environment."""

import numpy as np

from lerobot_gloves.tasks.mujoco_environment import MujocoEnvironment
from lerobot_gloves.tasks.set_point import SetPointControl
from lerobot_gloves.tasks.slalom import scene

MAX_DELTA = 0.01
"""Largest set-point displacement of one action, in metres an axis."""


class Slalom(MujocoEnvironment):
    """Steer a rod through the requested gap of each of three rows of pillars.

    An action (2,) moves the set-point of the rod's tip by (dx, dy) metres; it is clipped to +-`MAX_DELTA` an axis,
    and the set-point to `scene.WORKSPACE`. Control runs at 20 Hz. Episode s is for corridor `MODES[s % 24]` when it
    is reset with seed s, so that consecutive seeds visit all corridors equally often; nothing else is random, and
    without a seed the corridor is drawn.

    Observations:
        agent_pos: (4,) set-point xy and actual tip xy, metres.
        environment_state: (12,) pillar centres, metres; only with obs_type "state".
        pixels: {"front": (image_size, image_size, 3) uint8}; only with obs_type "pixels_agent_pos". The requested
            corridor cannot be seen in it.
        goal: (9,) one-hot gaps of the three rows, 2 + 3 + 4.

    Success: the tip passed y = 0.35 through the requested corridor. Failures: "collision" (the rod touched a pillar),
    "wrong_corridor" (it passed a row through another gap) and "timeout".

    Args:
        obs_type: One of `lerobot_gloves.tasks.environment.OBSERVATION_TYPES`.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        mode: Corridor of every episode, such as "0 2 3"; None lets the seed choose. `options={"mode": ...}` of
            `reset` goes before it.
        render_mode: Only "rgb_array".

    Raises:
        ValueError: If the observation type or mode is unknown.
    """

    action_bound = MAX_DELTA
    action_form = "two finite numbers (dx, dy) in metres"
    viewpoint = scene.CAMERA
    period = len(scene.MODES)

    def __init__(
        self,
        *,
        obs_type: str = "state",
        image_size: int = 256,
        episode_length: int = 300,
        mode: str | None = None,
        render_mode: str = "rgb_array",
    ) -> None:
        super().__init__(
            extra="slalom",
            make_model=scene.model,
            mode=mode,
            state=4,
            goal=sum(scene.GAPS),
            scene=scene.PILLARS.size,
            actions=2,
            cameras=(scene.CAMERA,),
            obs_type=obs_type,
            image_size=image_size,
            episode_length=episode_length,
            render_mode=render_mode,
        )
        height = [scene.TIP_HEIGHT] * 2
        self._control = SetPointControl(self._model, self._data, np.column_stack([scene.WORKSPACE, height]))
        self._begin_mode(self._mode_of(0) if mode is None else mode)

    @property
    def task_description(self) -> str:
        """The requested corridor, such as "0 2 3"."""
        return self._mode

    def _mode_of(self, number: int) -> str:
        return scene.mode_of(number)

    def _begin_mode(self, mode: str) -> None:
        self._gaps = scene.parse_mode(mode)
        self._mode = mode
        self._control.reset(np.array([*scene.START, scene.TIP_HEIGHT]), scene.start_joints(), iterations=0)

    def _advance(self, action: np.ndarray) -> tuple[bool, str]:
        before = self._tip_xy()
        failure = "collision" if self._move(action) else ""
        after = self._tip_xy()
        for row, y in enumerate(scene.ROW_Y):
            if not failure and before[1] < y <= after[1] and scene.gap_of(row, after[0]) != self._gaps[row]:
                failure = "wrong_corridor"
        return not failure and bool(after[1] > scene.GOAL_Y), failure

    def _move(self, delta: np.ndarray) -> bool:
        """Simulate one control step; True if the rod touched a pillar at any moment of it."""
        self._control.move(np.array([*delta, 0.0]))
        touched = False
        for _ in range(self._substeps):
            self._mujoco.mj_step(self._model, self._data)
            touched = touched or self._data.ncon > 0  # only rod and pillars can touch
        return touched

    def _tip_xy(self) -> np.ndarray:
        return self._data.site_xpos[self._control.tip, :2].copy()

    def _agent_pos(self) -> np.ndarray:
        return np.concatenate([self._control.set_point[:2], self._tip_xy()])

    def _environment_state(self) -> np.ndarray:
        return scene.PILLARS.ravel()

    def _goal(self) -> np.ndarray:
        gaps = [np.eye(n, dtype=np.float32)[i] for n, i in zip(scene.GAPS, self._gaps, strict=True)]
        return np.concatenate(gaps)

    def _draw(self, camera: str) -> np.ndarray:
        return scene.draw(self._data.qpos, self._image_size)
