"""CAN as a Gymnasium environment."""

import numpy as np

from lerobot_gloves.tasks.can import scene
from lerobot_gloves.tasks.can.control import OperationalSpaceControl
from lerobot_gloves.tasks.mujoco_environment import MujocoEnvironment
from lerobot_gloves.tasks.panda import HOME

SETTLED_SPEED = 0.02
"""A can whose centre moves slower than this, in m/s, ..."""
SETTLED_STEPS = 5
"""... and that no part of the hand touches, for so many control steps on end, rests."""


class Can(MujocoEnvironment):
    """Pick up the can and place it in the requested quadrant of the destination bin.

    The scene, the control at 20 Hz and the draws at the start are those of robosuite's PickPlaceCan. Episode s is for
    quadrant s mod 4 when it is reset with seed s; the arm's joint angles and the can's pose at the start come from the
    same seed. Nothing else is random, and without a seed all of it is drawn.

    An action (7,) in [-1, 1] moves the hand by (x, y, z) times 0.05 metres and turns it by the rotation vector
    (3,) times 0.5 rad, in the world frame, from where it is; the last entry opens the fingers where it is negative
    and closes them where it is positive.

    Observations:
        agent_pos: (8,) position of the grip (metres) and orientation of the hand (quaternion w, x, y, z with
            x + y >= 0, about (0, 0.7, 0.7, 0) at home), distance of the fingers (metres).
        environment_state: (9,) position of the can (metres), direction of its axis, its position relative to the
            grip (metres); with obs_type "state" or `privileged`. The can is round: its axis is its orientation.
        pixels: {"third_person", "wrist": (image_size, image_size, 3) uint8}; only with obs_type "pixels_agent_pos".
            The requested quadrant cannot be seen in them.
        goal: (4,) one-hot quadrant, in the order of `scene.QUADRANTS`.

    Success: the can rests in the requested quadrant, and the hand has let go of it: slower than `SETTLED_SPEED` and
    untouched for `SETTLED_STEPS`. Failures: "dropped" (the can fell below the bins) and, at the end of time,
    "wrong_quadrant" (it rests in another quadrant) or "timeout" (anything else).

    Args:
        obs_type: One of `lerobot_gloves.tasks.environment.OBSERVATION_TYPES`.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        mode: Quadrant of every episode, as an instruction or as a name such as "top left"; None lets the seed choose.
            `options={"mode": ...}` of `reset` goes before it.
        privileged: Whether `environment_state` comes even beside pixels, for a scripted expert.
        render_mode: Only "rgb_array".

    Raises:
        ValueError: If the observation type or mode is unknown.
    """

    action_bound = 1.0
    action_form = "seven finite numbers"
    period = len(scene.MODES)

    def __init__(
        self,
        *,
        obs_type: str = "state",
        image_size: int = 256,
        episode_length: int = 400,
        mode: str | None = None,
        privileged: bool = False,
        render_mode: str = "rgb_array",
    ) -> None:
        super().__init__(
            extra="can",
            make_model=scene.model,
            mode=mode,
            state=8,
            goal=len(scene.QUADRANTS),
            scene=9,
            actions=7,
            cameras=scene.CAMERAS,
            obs_type=obs_type,
            image_size=image_size,
            episode_length=episode_length,
            privileged=privileged,
            render_mode=render_mode,
        )
        self._control = OperationalSpaceControl(self._model, self._data)
        self._grip = self._model.site(scene.GRIP_SITE).id
        self._can = self._model.body(scene.CAN_BODY).id
        roots = self._model.body_rootid[self._model.geom_bodyid]  # one for the robot, one for the can
        self._is_robot = roots == self._model.body_rootid[self._model.body(scene.HAND_BODY).id]
        self._is_can = roots == self._can
        self._begin_mode(self._mode_of(0) if mode is None else mode)

    @property
    def task_description(self) -> str:
        """The instruction."""
        return scene.MODES[self._quadrant]

    def _mode_of(self, number: int) -> str:
        return scene.MODES[number]

    def _begin_mode(self, mode: str) -> None:
        self._quadrant = scene.parse_mode(mode)
        self._settled = 0
        mujoco, model, data, rng = self._mujoco, self._model, self._data, self.np_random
        mujoco.mj_resetData(model, data)
        data.qpos[scene.ARM] = HOME + scene.INITIAL_NOISE * rng.standard_normal(7)
        data.qpos[scene.FINGERS] = scene.HALF_OPEN
        xy = scene.SOURCE_BIN[:2] + rng.uniform(-scene.CAN_SPREAD, scene.CAN_SPREAD)
        turn = rng.uniform(0, np.pi)  # half of the angle
        data.qpos[scene.CAN] = [*xy, scene.RESTING_HEIGHT, np.cos(turn), 0, 0, np.sin(turn)]
        self._control.reset()
        mujoco.mj_forward(model, data)

    def _advance(self, action: np.ndarray) -> tuple[bool, str]:
        self._simulate(action)
        self._settled = self._settled + 1 if self._is_left_alone() else 0
        position = self._data.xpos[self._can]
        self._rests_in = scene.quadrant_of(position) if self._settled >= SETTLED_STEPS else None
        return self._rests_in == self._quadrant, "dropped" if position[2] < scene.DESTINATION_BIN[2] else ""

    def _out_of_time(self) -> str:
        return "timeout" if self._rests_in is None else "wrong_quadrant"

    def _simulate(self, action: np.ndarray) -> None:
        mujoco, model, data = self._mujoco, self._model, self._data
        for substep in range(self._substeps):
            mujoco.mj_step1(model, data)
            if substep == 0:
                self._control.set_goal(action)
            self._control.apply()
            mujoco.mj_step2(model, data)
        mujoco.mj_kinematics(model, data)  # a physics step ends with new joint positions and old poses

    def _is_left_alone(self) -> bool:
        """Whether the can is slow and the robot does not touch it."""
        geoms = self._data.contact.geom
        touched = (self._is_robot[geoms].any(axis=1) & self._is_can[geoms].any(axis=1)).any()
        return not touched and float(np.linalg.norm(self._data.qvel[scene.CAN_VELOCITY])) < SETTLED_SPEED

    def _agent_pos(self) -> np.ndarray:
        orientation = np.zeros(4)
        self._mujoco.mju_mat2Quat(orientation, self._data.site_xmat[self._grip])
        if orientation[1] + orientation[2] < 0:
            orientation = -orientation
        width = -np.diff(self._data.qpos[scene.FINGERS])
        return np.concatenate([self._data.site_xpos[self._grip], orientation, width])

    def _environment_state(self) -> np.ndarray:
        can = self._data.xpos[self._can]
        axis = self._data.xmat[self._can].reshape(3, 3)[:, 2]
        return np.concatenate([can, axis, can - self._data.site_xpos[self._grip]])

    def _goal(self) -> np.ndarray:
        return np.eye(4, dtype=np.float32)[self._quadrant]

    def _draw(self, camera: str) -> np.ndarray:
        return scene.draw(self._data.qpos, camera, self._image_size)
