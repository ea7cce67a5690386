"""CAN's own control loop beside robosuite's."""

import mujoco
import numpy as np
import pytest

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.tasks.can import scene
from lerobot_gloves.tasks.can.control import OperationalSpaceControl
from lerobot_gloves.tasks.panda import HOME


@pytest.fixture(scope="module")
def robosuite_env():
    scene.model()  # imports robosuite without its hints
    import robosuite
    from robosuite.controllers import load_composite_controller_config

    return robosuite.make(
        "PickPlaceCan",
        robots="Panda",
        controller_configs=load_composite_controller_config(controller="BASIC", robot="Panda"),
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        ignore_done=True,
        hard_reset=False,
    )


def test_the_fingers_take_ten_steps_from_open_to_closed():
    model = scene.model()
    data = mujoco.MjData(model)
    data.qpos[scene.ARM] = HOME
    mujoco.mj_forward(model, data)
    control = OperationalSpaceControl(model, data)

    def command(grip):
        control.set_goal(np.array([0, 0, 0, 0, 0, 0, grip]))
        return data.ctrl[scene.FINGERS].tolist()

    for _ in range(5):  # from half open
        opened = command(-1.0)
    assert opened == pytest.approx([0.04, -0.04])
    widths = [np.subtract(*command(1.0)) for _ in range(10)]
    assert np.diff(widths) == pytest.approx(-0.008)
    assert widths[-1] == pytest.approx(0.0)
    assert command(0.0) == pytest.approx([0.0, 0.0])  # no sign, no motion


def test_torques_stay_within_the_motors_range_and_hold_the_arm_against_gravity():
    model = scene.model()
    data = mujoco.MjData(model)
    data.qpos[scene.ARM] = HOME
    mujoco.mj_forward(model, data)
    control = OperationalSpaceControl(model, data)
    control.set_goal(np.zeros(7))
    control.apply()
    # At rest, at its goal and in its posture: nothing but gravity.
    assert data.ctrl[scene.ARM] == pytest.approx(data.qfrc_bias[scene.ARM], abs=1e-9)
    data.qvel[scene.ARM] = 50.0
    mujoco.mj_forward(model, data)
    control.apply()
    assert (np.abs(data.ctrl[scene.ARM]) <= [80, 80, 80, 80, 80, 12, 12]).all()
    assert np.abs(data.ctrl[scene.ARM]).max() == 80


@pytest.mark.slow
def test_the_hand_and_the_can_move_as_in_robosuite(robosuite_env):
    np.random.seed(0)  # what robosuite draws from
    robosuite_env.reset()
    theirs = robosuite_env.sim.data._data
    model = scene.model()
    data = mujoco.MjData(model)
    can = robosuite_env.sim.model.get_joint_qpos_addr("Can_joint0")[0]
    data.qpos[:9], data.qpos[scene.CAN] = theirs.qpos[:9], theirs.qpos[can : can + 7]
    mujoco.mj_forward(model, data)
    control = OperationalSpaceControl(model, data)
    rng = np.random.default_rng(1)
    for _ in range(12):
        action = np.clip(rng.normal(0.0, 0.7, 7), -1, 1)
        for _ in range(5):
            robosuite_env.step(action)
            for substep in range(25):
                mujoco.mj_step1(model, data)
                if substep == 0:
                    control.set_goal(action)
                control.apply()
                mujoco.mj_step2(model, data)
            # robosuite turns rotations through single precision.
            assert data.qpos[:9] == pytest.approx(theirs.qpos[:9], abs=1e-4)
            assert data.qpos[scene.CAN] == pytest.approx(theirs.qpos[can : can + 7], abs=1e-6)
    assert np.abs(data.qpos[scene.ARM] - HOME).max() > 0.3


@pytest.mark.slow
def test_episodes_start_as_in_robosuite(robosuite_env):
    np.random.seed(1)
    assert robosuite_env.robots[0].init_qpos == pytest.approx(HOME)
    can = robosuite_env.sim.model.get_joint_qpos_addr("Can_joint0")[0]
    starts = []
    for _ in range(60):
        robosuite_env.reset()
        starts.append(robosuite_env.sim.data.qpos.copy())
    starts = np.array(starts)
    assert starts[:, :7].std(axis=0) == pytest.approx(scene.INITIAL_NOISE, rel=0.35)
    assert starts[0, 7:9] == pytest.approx(scene.HALF_OPEN)
    offsets = np.abs(starts[:, can : can + 2] - scene.SOURCE_BIN[:2])
    assert (offsets <= scene.CAN_SPREAD).all() and (offsets.max(axis=0) > 0.85 * scene.CAN_SPREAD).all()
    assert starts[:, can + 2] == pytest.approx(scene.RESTING_HEIGHT, abs=1e-3)
