"""Charger Plug as a Gymnasium environment."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_gloves.tasks.charger import drawing
from lerobot_gloves.tasks.charger.scene import Scene, gripping, is_plugged_in, offset, pose_vector
from lerobot_gloves.tasks.environment import TaskEnvironment

CAMERAS = ("wrist",)
TASK = "Plug the charger into the receptacle."


def check_hidden(obs_type: str, hide_receptacle: bool) -> None:
    """Refuse to hide from pictures what they show.

    Raises:
        ValueError: If the receptacle shall be hidden where observations are not states.
    """
    if hide_receptacle and obs_type != "state":
        raise ValueError(f"Charger hides the receptacle with obs_type state only, not {obs_type}: pictures show it")


class Charger(TaskEnvironment):
    """Pick up the charger and plug it into the receptacle, with half a millimetre to spare on either side.

    The scene, its draws, the control at 20 Hz and the test of success are those of ManiSkill's PlugCharger-v1.
    `reset(seed=s)` gives what ManiSkill gives for seed s; nothing else is random, and what was played before does not
    matter. `reset` knows no options.

    An action (8,) in [-1, 1] moves each of the 7 joints from where it is by its entry times 0.1 rad; the last entry is
    the opening of the fingers, 1 for wide open, -1 for pressed together.

    Observations:
        agent_pos: (25,) positions of the joints (rad) and the two fingers (metres), their velocities (a second), and
            the pose of the tool, which is the point between the finger tips.
        environment_state: (26,) pose of the charger (7) and how far the tool is from gripping it (6), pose of the
            receptacle (7) and how far the charger is from the goal (6); with obs_type "state" or `privileged`. The
            first 13 if the receptacle is hidden.
        pixels: {"wrist": (image_size, image_size, 3) uint8}; only with obs_type "pixels_agent_pos".
        goal: (14,) pose of the receptacle, and the pose that the charger shall have; (20,) with how far it is from that
            if the receptacle is hidden.

    How far one thing is from another is `scene.offset`. A pose is a position (metres) and a quaternion (w, x, y, z),
    the tool's with x >= 0, the receptacle's with z >= 0, the others' with w >= 0.

    Success: the charger is within 5 mm and 0.2 rad of the goal. The one failure is "timeout".

    Args:
        obs_type: One of `lerobot_gloves.tasks.environment.OBSERVATION_TYPES`; pixels need a Vulkan driver.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        hide_receptacle: Whether `environment_state` leaves the receptacle out.
        privileged: Whether `environment_state` comes even beside pixels, for a scripted expert.
        render_mode: Only "rgb_array".

    Raises:
        ValueError: If the observation type is unknown, or pictures shall hide the receptacle.
        RuntimeError: If pixels are asked for and no Vulkan driver can draw them.
    """

    action_bound = 1.0
    action_form = "eight finite numbers"

    def __init__(
        self,
        *,
        obs_type: str = "state",
        image_size: int = 256,
        episode_length: int = 300,
        hide_receptacle: bool = False,
        privileged: bool = False,
        render_mode: str = "rgb_array",
    ) -> None:
        super().__init__(
            state=25,
            goal=20 if hide_receptacle else 14,
            goal_range=(-np.inf, np.inf),
            scene=13 if hide_receptacle else 26,
            actions=8,
            cameras=CAMERAS,
            obs_type=obs_type,
            image_size=image_size,
            episode_length=episode_length,
            privileged=privileged,
            render_mode=render_mode,
        )
        check_hidden(obs_type, hide_receptacle)
        self._hide_receptacle = hide_receptacle
        self._scene = Scene()
        self._begin(0, {})

    @property
    def task_description(self) -> str:
        """The instruction, the same in every episode."""
        return TASK

    def _begin(self, seed: int | None, options: Mapping[str, Any]) -> None:
        self._scene.reset(int(self.np_random.integers(2**31)) if seed is None else seed)
        self._receptacle = pose_vector(self._scene.receptacle, 3)

    def _advance(self, action: np.ndarray) -> tuple[bool, str]:
        self._scene.step(action.astype(np.float32))
        return is_plugged_in(self._scene.charger, self._scene.goal), ""

    def _agent_pos(self) -> np.ndarray:
        scene = self._scene
        return np.concatenate([scene.joint_positions, scene.joint_velocities, pose_vector(scene.tool, 1)])

    def _environment_state(self) -> np.ndarray:
        charger = self._scene.charger
        seen = [pose_vector(charger, 0), offset(self._scene.tool, gripping(charger))]
        return np.concatenate(seen if self._hide_receptacle else [*seen, self._receptacle, self._missing()])

    def _goal(self) -> np.ndarray:
        goal = [self._receptacle, pose_vector(self._scene.goal, 0)]
        return np.concatenate([*goal, self._missing()] if self._hide_receptacle else goal).astype(np.float32)

    def _missing(self) -> np.ndarray:
        """How far the charger is from the goal."""
        return offset(self._scene.charger, self._scene.goal)

    def _draw(self, camera: str) -> np.ndarray:
        return drawing.draw(self._scene, camera, self._image_size)

    def render(self) -> np.ndarray:
        """The third-person camera's frame (image_size, image_size, 3), uint8 RGB; black without a Vulkan driver."""
        if not self._cameras and drawing.missing_driver():
            # LeRobot's commands film whatever they evaluate, and states need no driver.
            return drawing.blank(self._image_size)
        return super().render()
