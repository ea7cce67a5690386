"""What the tasks' Gymnasium environments have in common."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

CONTROL_HZ = 20
OBSERVATION_TYPES = ("state", "pixels_agent_pos")


def check_observation_type(task: str, obs_type: str) -> None:
    """Refuse an unknown observation type.

    Raises:
        ValueError: If it is not one of `OBSERVATION_TYPES`.
    """
    if obs_type not in OBSERVATION_TYPES:
        raise ValueError(f"{task} has no obs_type {obs_type!r}: choose one of {', '.join(OBSERVATION_TYPES)}")


class TaskEnvironment(gym.Env, ABC):
    """Steps of a twentieth of a second until the episode succeeds, fails or runs out of time.

    A task says how an episode begins (`_begin`), what an action does (`_advance`), and what is observed.

    Every `info` holds `is_success` and `failure`: "" or why the episode ended without success. The reward is 1 at
    success, else 0.

    Attributes:
        action_bound: What the entries of an action are clipped to, to either side.
        action_form: What an action is, for those who give something else.
        viewpoint: The camera that sees it all.
        wanted: Whether somebody looks at the next frames of `pixels`; if not, the last ones are shown again.

    Args:
        state: Length of `agent_pos`.
        goal: Length of `goal`.
        scene: Length of `environment_state`.
        actions: Length of an action.
        cameras: Names of the frames in `pixels`.
        obs_type: One of `OBSERVATION_TYPES`: the scene's state is observed, or pixels are.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        privileged: Whether `environment_state` comes even beside pixels, for a scripted expert.
        render_mode: Only "rgb_array".
        goal_range: Between what the goal's entries lie.

    Raises:
        ValueError: If the observation type is unknown.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}
    action_bound: float
    action_form: str
    viewpoint = "third_person"

    def __init__(
        self,
        *,
        state: int,
        goal: int,
        scene: int,
        actions: int,
        cameras: Collection[str],
        obs_type: str,
        image_size: int,
        episode_length: int,
        privileged: bool = False,
        render_mode: str = "rgb_array",
        goal_range: tuple[float, float] = (0.0, 1.0),
    ) -> None:
        check_observation_type(type(self).__name__, obs_type)
        self.render_mode = render_mode
        self._image_size, self._max_episode_steps = image_size, episode_length
        self._sees_scene = obs_type == "state" or privileged
        self._cameras = () if obs_type == "state" else tuple(cameras)
        self.action_space = gym.spaces.Box(-self.action_bound, self.action_bound, (actions,), np.float32)
        spaces: dict[str, gym.Space] = {
            "agent_pos": gym.spaces.Box(-np.inf, np.inf, (state,), np.float32),
            "goal": gym.spaces.Box(*goal_range, (goal,), np.float32),
        }
        if self._sees_scene:
            spaces["environment_state"] = gym.spaces.Box(-np.inf, np.inf, (scene,), np.float32)
        if self._cameras:
            frame = gym.spaces.Box(0, 255, (image_size, image_size, 3), np.uint8)
            spaces["pixels"] = gym.spaces.Dict(dict.fromkeys(self._cameras, frame))
        self.observation_space = gym.spaces.Dict(spaces)
        self._steps = 0
        self.wanted = True
        self._frames: dict[str, np.ndarray] = {}

    @property
    @abstractmethod
    def task_description(self) -> str:
        """What is asked for in this episode."""

    @property
    def task(self) -> str:
        """The same, under the other name that LeRobot asks for."""
        return self.task_description

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Settles all that is random, as the task says; None draws it.
            options: As the task says; keys that it does not know are ignored.

        Raises:
            ValueError: If an option's value is unknown.
        """
        super().reset(seed=seed)
        self._begin(seed, options or {})
        self._steps = 0
        return self._observation(), {"is_success": False, "failure": ""}

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Simulate one twentieth of a second, or less if the episode ends before.

        Args:
            action: As the task says; clipped to `action_bound`.

        Raises:
            ValueError: If the action has another form, or entries that are not finite.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != self.action_space.shape or not np.isfinite(action).all():
            raise ValueError(f"a {type(self).__name__} action is {self.action_form}, not {action.tolist()}")
        success, failure = self._advance(np.clip(action, -self.action_bound, self.action_bound))
        self._steps += 1
        terminated = success or bool(failure)
        truncated = not terminated and self._steps >= self._max_episode_steps
        if truncated:
            failure = self._out_of_time()
        return self._observation(), float(success), terminated, truncated, {"is_success": success, "failure": failure}

    def render(self) -> np.ndarray:
        """The frame (image_size, image_size, 3) of `viewpoint`, uint8 RGB."""
        return self._draw(self.viewpoint)

    @abstractmethod
    def _begin(self, seed: int | None, options: Mapping[str, Any]) -> None:
        """Put everything where it is at the beginning of an episode."""

    @abstractmethod
    def _advance(self, action: np.ndarray) -> tuple[bool, str]:
        """Do what a clipped action says; returns whether the task is done, and why it can no longer be, or ""."""

    def _out_of_time(self) -> str:
        """Why an episode that ran out of time failed."""
        return "timeout"

    def _observation(self) -> dict[str, Any]:
        observation: dict[str, Any] = {"agent_pos": self._agent_pos().astype(np.float32), "goal": self._goal()}
        if self._sees_scene:
            observation["environment_state"] = self._environment_state().astype(np.float32)
        if self._cameras:
            if self.wanted or not self._frames:
                self._frames = {camera: self._draw(camera) for camera in self._cameras}
            observation["pixels"] = dict(self._frames)
        return observation

    @abstractmethod
    def _agent_pos(self) -> np.ndarray:
        """What the robot feels of itself."""

    @abstractmethod
    def _environment_state(self) -> np.ndarray:
        """Where things are that only eyes can tell."""

    @abstractmethod
    def _goal(self) -> np.ndarray:
        """What is asked for, float32, of its own memory; for the agent only."""

    @abstractmethod
    def _draw(self, camera: str) -> np.ndarray:
        """A camera's frame (image_size, image_size, 3), uint8 RGB."""
