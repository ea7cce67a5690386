"""Keypad as a Gymnasium environment."""

import numpy as np

from lerobot_gloves.tasks.keypad import scene
from lerobot_gloves.tasks.mujoco_environment import MujocoEnvironment
from lerobot_gloves.tasks.set_point import SetPointControl

MAX_DELTA = 0.01
"""Largest set-point displacement of one action, in metres an axis."""

FROM_HOME = 0.1
"""Share of the press episodes that begin at home, with no button pressed before."""


class Keypad(MujocoEnvironment):
    """Enter a code of three buttons with a stylus, or press one button.

    An action (3,) moves the set-point of the stylus's tip by (dx, dy, dz) metres; it is clipped to +-`MAX_DELTA` an
    axis, and the set-point to `scene.WORKSPACE`; the stylus always points down. Control runs at 20 Hz. A button fires
    when it has travelled 5 mm, and can fire again once it is back below 2 mm; both are looked at after every substep
    of 2 ms. A button that fires when it is due lights up.

    With episode "code", `reset(seed=s)` asks for code `scene.code_of(s)`, so that consecutive seeds ask for very
    different codes and 729 of them for each code once; nothing else is random.

    With episode "press" it asks for button s % 9 alone, and the episode is a cut-out of a code: in nine cases of ten
    it begins with a random button, maybe the same one, just pressed and lit, the stylus still on it and up to nine
    steps deeper, as an agent that executes its chunk to the end leaves it; in half of these the light of a further
    random button is on. The others begin like a code. The seed settles all of that; without one it is drawn.

    Observations:
        agent_pos: (9,) tip xyz and set-point xyz, metres; velocity of the tip, metres a second.
        environment_state: (18,) travels of the buttons, metres; their lights, 0 or 1; only with obs_type "state".
        pixels: {"third_person", "wrist": (image_size, image_size, 3) uint8}; only with obs_type "pixels_agent_pos".
            Which button is due cannot be seen in them.
        goal: (9,) one-hot button that is due now; it moves on at each press.

    Success: all was entered in order. Failures: "wrong_button" (another button than the one due fired), "collision"
    (the stylus touched the frame or the plate below) and "timeout".

    Args:
        obs_type: One of `lerobot_gloves.tasks.environment.OBSERVATION_TYPES`.
        image_size: Height and width of observed and rendered frames, in pixels.
        episode_length: Control steps until a timeout.
        episode: "code" or "press".
        mode: Code of every episode, such as "4 0 8", or the button to press, such as "4"; None lets the seed choose.
            `options={"mode": ...}` of `reset` goes before it.
        render_mode: Only "rgb_array".

    Raises:
        ValueError: If the observation type, episode or mode is unknown.
    """

    action_bound = MAX_DELTA
    action_form = "three finite numbers (dx, dy, dz) in metres"
    period = len(scene.CODES)

    def __init__(
        self,
        *,
        obs_type: str = "state",
        image_size: int = 256,
        episode_length: int = 1000,
        episode: str = "code",
        mode: str | None = None,
        render_mode: str = "rgb_array",
    ) -> None:
        buttons = len(scene.BUTTONS)
        scene.check_mode(episode, mode)
        super().__init__(
            extra="keypad",
            make_model=scene.model,
            mode=mode,
            state=9,
            goal=buttons,
            scene=2 * buttons,
            actions=3,
            cameras=scene.CAMERAS,
            obs_type=obs_type,
            image_size=image_size,
            episode_length=episode_length,
            render_mode=render_mode,
        )
        self._episode = episode
        self._control = SetPointControl(self._model, self._data, scene.WORKSPACE)
        # The stylus can touch the buttons and what belongs to the world.
        self._is_frame = (self._model.geom_bodyid == 0) & (self._model.geom_conaffinity == 1)
        self._travels = self._data.qpos[7:]
        self._begin_at(scene.START, mode or self._mode_of(0))

    @property
    def task_description(self) -> str:
        """The requested code, such as "4 0 8", or the button to press."""
        return self._mode

    def _mode_of(self, number: int) -> str:
        return scene.code_of(number) if self._episode == "code" else scene.PRESSES[number % len(scene.PRESSES)]

    def _begin_mode(self, mode: str) -> None:
        scene.check_mode(self._episode, mode)
        if self._episode == "press" and self.np_random.random() >= FROM_HOME:
            self._begin_pressed(mode)
        else:
            self._begin_at(scene.START, mode)

    def _begin_at(self, position: np.ndarray, mode: str) -> None:
        """Begin with the tip at a point (3,) and no button pressed."""
        self._mode = mode
        self._due = [int(button) for button in mode.split()]
        self._control.reset(position, scene.start_joints(), iterations=20)
        self._armed = np.ones(len(scene.BUTTONS), dtype=bool)
        self._lights = np.zeros(len(scene.BUTTONS), dtype=bool)

    def _begin_pressed(self, mode: str) -> None:
        """Begin with a random button just pressed, by moves a little more varied than the expert's."""
        rng = self.np_random
        button, other = map(int, rng.integers(len(scene.BUTTONS), size=2))
        begin = [*scene.BUTTONS[button] + rng.uniform(-0.009, 0.009, 2), scene.FRAME_TOP]
        move = np.array([*rng.uniform(-0.0003, 0.0003, 2), -rng.uniform(0.002, 0.0045)])
        deeper = int(rng.integers(10))
        self._begin_at(np.array(begin), mode)
        requested = len(self._due)
        self._due = [button, *self._due]
        while len(self._due) > requested:
            self._move(move)
        for _ in range(deeper):
            self._move(move)
        if rng.random() < 0.5:
            self._lights[other] = True

    def _advance(self, action: np.ndarray) -> tuple[bool, str]:
        failure = self._move(action)
        return not self._due, failure

    def _move(self, delta: np.ndarray) -> str:
        """Simulate one control step, or the part of it after which nothing is due or all is lost; returns why it is."""
        self._control.move(delta)
        for _ in range(self._substeps):
            self._mujoco.mj_step(self._model, self._data)
            if self._data.ncon and self._touches_frame():
                return "collision"
            self._armed |= self._travels < scene.REARM
            for button in (self._armed & (self._travels > scene.PRESS)).nonzero()[0]:
                self._armed[button] = False
                if button != self._due[0]:
                    return "wrong_button"
                self._lights[button] = True
                self._due = self._due[1:]
                if not self._due:
                    return ""
        return ""

    def _touches_frame(self) -> bool:
        return bool(self._is_frame[self._data.contact.geom].any())

    def _agent_pos(self) -> np.ndarray:
        velocity = np.zeros(6)  # angular, then linear
        site, tip = self._mujoco.mjtObj.mjOBJ_SITE, self._control.tip
        self._mujoco.mj_objectVelocity(self._model, self._data, site, tip, velocity, 0)
        return np.concatenate([self._data.site_xpos[tip], self._control.set_point, velocity[3:]])

    def _environment_state(self) -> np.ndarray:
        return np.concatenate([self._travels, self._lights])

    def _goal(self) -> np.ndarray:
        goal = np.zeros(len(scene.BUTTONS), dtype=np.float32)
        goal[self._due[:1]] = 1.0
        return goal

    def _draw(self, camera: str) -> np.ndarray:
        return scene.draw(self._data.qpos, self._lights, camera, self._image_size)
