"""Slalom as a Gymnasium environment."""

from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_gloves.tasks.configuration import check_observation_type
from lerobot_gloves.tasks.panda import PREFIX, InverseKinematics, import_mujoco
from lerobot_gloves.tasks.slalom import scene
from lerobot_gloves.tasks.spaces import observation_space

CONTROL_HZ = 20
MAX_DELTA = 0.01
"""Largest set-point displacement of one action, in metres an axis."""


class Slalom(gym.Env):
    """Steer a rod through the requested gap of each of three rows of pillars.

    An action (2,) moves the set-point of the rod's tip by (dx, dy) metres; it is clipped to +-`MAX_DELTA` an axis,
    and the set-point to `scene.WORKSPACE`. Control runs at 20 Hz. Episode s is for corridor `MODES[s % 24]` when it
    is reset with seed s, so that consecutive seeds visit all corridors equally often; nothing else is random.

    Observations:
        agent_pos: (4,) set-point xy and actual tip xy, metres.
        environment_state: (12,) pillar centres, metres; only with obs_type "state".
        pixels: {"front": (image_size, image_size, 3) uint8}; only with obs_type "pixels_agent_pos". The requested
            corridor cannot be seen in it.
        goal: (9,) one-hot gaps of the three rows, 2 + 3 + 4.

    Every `info` holds `is_success` (the tip passed y = 0.35 through the requested corridor) and `failure`: "" or
    why the episode ended without success: "collision" (the rod touched a pillar), "wrong_corridor" (it passed a
    row through another gap) or "timeout". The reward is 1 at success, else 0.

    Args:
        obs_type: One of `lerobot_gloves.tasks.configuration.OBSERVATION_TYPES`.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        mode: Corridor of every episode, such as "0 2 3"; None lets the seed choose. `options={"mode": ...}` of
            `reset` goes before it.
        render_mode: Only "rgb_array".

    Raises:
        ValueError: If the observation type or mode is unknown.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}

    def __init__(
        self,
        *,
        obs_type: str = "state",
        image_size: int = 256,
        episode_length: int = 300,
        mode: str | None = None,
        render_mode: str = "rgb_array",
    ) -> None:
        check_observation_type("Slalom", obs_type)
        if mode is not None:
            scene.parse_mode(mode)
        self.render_mode = render_mode
        self._obs_type, self._image_size, self._fixed_mode = obs_type, image_size, mode
        self._max_episode_steps = episode_length
        self.action_space = gym.spaces.Box(-MAX_DELTA, MAX_DELTA, (2,), np.float32)
        told = obs_type == "state"
        self.observation_space = observation_space(
            state=4,
            goal=sum(scene.GAPS),
            scene=scene.PILLARS.size if told else None,
            cameras=() if told else (scene.CAMERA,),
            image_size=image_size,
        )

        self._mujoco = import_mujoco("slalom")
        self._model = scene.model()
        self._data = self._mujoco.MjData(self._model)
        self._inverse_kinematics = InverseKinematics(self._model)
        self._tip = self._model.site(f"{PREFIX}tip").id
        self._substeps = round(1 / CONTROL_HZ / self._model.opt.timestep)
        self._begin(mode or scene.MODES[0])

    @property
    def task_description(self) -> str:
        """The requested corridor, such as "0 2 3"."""
        return self._mode

    @property
    def task(self) -> str:
        """The same, under the other name that LeRobot asks for."""
        return self._mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Chooses corridor `MODES[seed % 24]`; None draws one.
            options: `{"mode": "0 2 3"}` fixes the corridor; other keys are ignored.

        Raises:
            ValueError: If the mode is unknown.
        """
        super().reset(seed=seed)
        mode = (options or {}).get("mode") or self._fixed_mode
        if mode is None:
            index = int(self.np_random.integers(len(scene.MODES))) if seed is None else seed % len(scene.MODES)
            mode = scene.MODES[index]
        self._begin(mode)
        return self._observation(), {"is_success": False, "failure": ""}

    def _begin(self, mode: str) -> None:
        self._gaps = scene.parse_mode(mode)
        self._mode = mode
        self._goal = np.concatenate(
            [np.eye(n, dtype=np.float32)[i] for n, i in zip(scene.GAPS, self._gaps, strict=True)]
        )
        self._steps = 0
        self._set_point = scene.START.copy()
        self._joints = scene.start_joints()
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._joints
        self._data.ctrl[:] = self._joints
        self._mujoco.mj_forward(self._model, self._data)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Move the set-point and simulate one twentieth of a second.

        Args:
            action: (2,) displacement of the set-point, metres.

        Raises:
            ValueError: If the action is not two finite numbers.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (2,) or not np.isfinite(action).all():
            raise ValueError(f"a Slalom action is two finite numbers (dx, dy) in metres, not {action.tolist()}")
        before = self._tip_xy()
        collision = self._move(np.clip(action, -MAX_DELTA, MAX_DELTA))
        self._steps += 1
        after = self._tip_xy()
        failure = "collision" if collision else ""
        for row, y in enumerate(scene.ROW_Y):
            if not failure and before[1] < y <= after[1] and scene.gap_of(row, after[0]) != self._gaps[row]:
                failure = "wrong_corridor"
        success = not failure and bool(after[1] > scene.GOAL_Y)
        terminated = success or bool(failure)
        truncated = not terminated and self._steps >= self._max_episode_steps
        if truncated:
            failure = "timeout"
        info = {"is_success": success, "failure": failure}
        return self._observation(), float(success), terminated, truncated, info

    def _move(self, delta: np.ndarray) -> bool:
        """Simulate one control step; True if the rod touched a pillar at any moment of it."""
        self._set_point = np.clip(self._set_point + delta, *scene.WORKSPACE)
        position = np.array([*self._set_point, scene.TIP_HEIGHT])
        self._joints = self._inverse_kinematics.solve(position, self._joints, iterations=3)
        self._data.ctrl[:] = self._joints
        touched = False
        for _ in range(self._substeps):
            self._mujoco.mj_step(self._model, self._data)
            touched = touched or self._data.ncon > 0  # only rod and pillars can touch
        return touched

    def _tip_xy(self) -> np.ndarray:
        return self._data.site_xpos[self._tip, :2].copy()

    def _observation(self) -> dict[str, Any]:
        observation: dict[str, Any] = {
            "agent_pos": np.concatenate([self._set_point, self._tip_xy()]).astype(np.float32),
            "goal": self._goal.copy(),
        }
        if self._obs_type == "state":
            observation["environment_state"] = scene.PILLARS.astype(np.float32).ravel()
        else:
            observation["pixels"] = {scene.CAMERA: self.render()}
        return observation

    def render(self) -> np.ndarray:
        """The front camera's frame (image_size, image_size, 3), uint8 RGB."""
        return scene.draw(self._data.qpos, self._image_size)
