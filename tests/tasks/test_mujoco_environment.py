"""What MuJoCo's tasks share, on a scene of two balls that fall."""

import mujoco
import numpy as np
import pytest

from lerobot_gloves.tasks.mujoco_environment import MujocoEnvironment

MODES = ("low", "middle", "high")
BEGUN = {"is_success": False, "failure": ""}


def two_balls():
    scene = mujoco.MjSpec()
    scene.option.timestep = 0.004
    for x in (0.0, 1.0):
        ball = scene.worldbody.add_body(pos=[x, 0.0, 0.0])
        ball.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0], mass=1.0)
    return scene.compile()


class Falling(MujocoEnvironment):
    action_bound = 1.0
    action_form = "one finite number"
    period = len(MODES)

    def __init__(self, mode=None):
        super().__init__(
            extra="all",
            make_model=two_balls,
            mode=mode,
            state=2,
            goal=1,
            scene=1,
            actions=1,
            cameras=(),
            obs_type="state",
            image_size=8,
            episode_length=4,
        )
        self._begin_mode(mode or MODES[0])

    @property
    def task_description(self):
        return self._mode

    def _mode_of(self, number):
        return MODES[number]

    def _begin_mode(self, mode):
        if mode not in MODES:
            raise ValueError(f"no {mode}")
        self._mode = mode
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = [MODES.index(mode), self.np_random.random()]

    def _advance(self, action):
        for _ in range(self._substeps):
            self._mujoco.mj_step(self._model, self._data)
        return False, ""

    def _agent_pos(self):
        return self._data.qpos

    def _environment_state(self):
        return self._data.qvel[:1]

    def _goal(self):
        return np.zeros(1, dtype=np.float32)

    def _draw(self, camera):
        raise NotImplementedError


@pytest.fixture(scope="module")
def env():
    return Falling()


def test_a_step_is_a_twentieth_of_a_second_whatever_the_models_timestep(env):
    start = env.reset(seed=0)[0]["agent_pos"][0]
    steps = round(0.05 / 0.004)
    for count in (1, 2):
        observation, *_ = env.step(np.zeros(1))
        # Semi-implicit Euler: after n steps of length h, a fall is g h^2 n (n + 1) / 2.
        n = count * steps
        assert observation["agent_pos"][0] == pytest.approx(start - 9.81 * 0.004**2 * n * (n + 1) / 2, rel=1e-4)


def test_options_go_before_the_fixed_mode_and_that_before_the_seed(env):
    assert [env.reset(seed=seed) and env.task for seed in range(20000, 20006)] == [
        MODES[seed % 3] for seed in range(20000, 20006)
    ]
    fixed = Falling("high")
    assert fixed.task == "high"
    assert fixed.reset(seed=0)[1] == BEGUN and fixed.task == "high"
    assert fixed.reset()[1] == BEGUN and fixed.task == "high"
    fixed.reset(seed=0, options={"mode": "middle", "unknown": 3})
    assert fixed.task == "middle"
    fixed.reset(seed=0, options={"unknown": 3})
    assert fixed.task == "high"


def test_a_seed_settles_the_episode_and_without_one_the_same_generator_goes_on(env):
    rng = np.random.default_rng(7)  # Gymnasium's for a seed
    heights = [env.reset(seed=7)[0]["agent_pos"][1]]
    assert env.task == MODES[7 % 3] and heights == [np.float32(rng.random())]
    for _ in range(5):
        observation, info = env.reset()
        # The mode is drawn first, then what the task draws itself.
        assert env.task == MODES[rng.integers(3)] and info == BEGUN
        assert observation["agent_pos"][1] == np.float32(rng.random())
    env.reset(options={"mode": "low"})  # where a mode is given none is drawn
    assert env.reset()[0]["agent_pos"][1] != np.float32(rng.random())
    assert env.reset(seed=7, options={"mode": "high"})[0]["agent_pos"][1] == heights[0]


def test_a_new_episode_has_all_its_time_and_an_unknown_mode_begins_none(env):
    env.reset(seed=0)
    for _ in range(2):
        outcomes = [env.step(np.zeros(1))[3:] for _ in range(4)]
        assert outcomes == [(False, BEGUN)] * 3 + [(True, {"is_success": False, "failure": "timeout"})]
        env.reset(seed=1)
    env.step(np.zeros(1))
    before = env._data.qpos.copy()
    with pytest.raises(ValueError, match="no top"):
        env.reset(options={"mode": "top"})
    assert env.task == MODES[1] and np.array_equal(env._data.qpos, before)
    assert [env.step(np.zeros(1))[3] for _ in range(3)] == [False, False, True]  # its time runs on
