"""The arm follows its set-point."""

import mujoco
import numpy as np
import pytest

from lerobot_gloves.tasks.panda import HOME, panda_scene
from lerobot_gloves.tasks.set_point import SetPointControl

WORKSPACE = np.array([[0.4, -0.1, 0.1], [0.6, 0.1, 0.2]])
MIDDLE = np.array([0.5, 0.0, 0.15])


@pytest.fixture(scope="module")
def model():
    return panda_scene(rod_length=0.2, rod_radius=0.01, visual=False).compile()


@pytest.fixture
def arm(model):
    data = mujoco.MjData(model)
    control = SetPointControl(model, data, WORKSPACE)
    control.reset(MIDDLE, HOME, iterations=300)
    return control, data


def tip_at(model, joints):
    """The tip's place and its axis by MuJoCo's forward kinematics."""
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_forward(model, data)
    tip = data.site("panda/tip")
    return tip.xpos, tip.xmat.reshape(3, 3)[:, 2]


def test_an_episode_begins_at_rest_with_the_tool_pointing_down_at_the_set_point(model, arm):
    control, data = arm
    control.move(np.full(3, 0.01))
    mujoco.mj_step(model, data, 20)
    control.reset(MIDDLE, HOME, iterations=300)
    place, axis = tip_at(model, data.qpos)
    assert place == pytest.approx(MIDDLE, abs=1e-4) and axis == pytest.approx([0, 0, -1], abs=1e-2)
    assert np.array_equal(data.qpos, data.ctrl) and not data.qvel.any() and data.time == 0
    assert np.array_equal(data.site_xpos[control.tip], place)  # the state is that of the new positions
    joints = data.qpos.copy()
    control.reset(MIDDLE, joints, iterations=0)
    assert np.array_equal(data.qpos, joints)


def test_the_servos_are_told_to_hold_the_tip_at_the_set_point_all_along_a_way(model, arm):
    control, data = arm
    moves = np.random.default_rng(0).uniform(-0.01, 0.01, (60, 3))
    for move in moves:
        before = control.set_point
        control.move(move)
        assert control.set_point == pytest.approx(np.clip(before + move, *WORKSPACE), abs=1e-12)
        place, axis = tip_at(model, data.ctrl)
        assert place == pytest.approx(control.set_point, abs=5e-4) and axis == pytest.approx([0, 0, -1], abs=2e-2)
    mujoco.mj_step(model, data, 500)
    assert data.site_xpos[control.tip] == pytest.approx(control.set_point, abs=1e-3)


def test_the_set_point_stays_in_the_workspace_and_the_start_stays_the_callers(arm):
    control, _ = arm
    start = MIDDLE.copy()
    control.reset(start, HOME, iterations=300)
    for _ in range(30):
        control.move(np.array([0.01, -0.01, 0.01]))
    assert control.set_point == pytest.approx([0.6, -0.1, 0.2], abs=1e-12)
    assert np.array_equal(start, MIDDLE)
