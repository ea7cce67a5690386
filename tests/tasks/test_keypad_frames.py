"""What Keypad's cameras show, and what they do not."""

import numpy as np
import pytest

from lerobot_gloves.tasks.keypad import scene
from lerobot_gloves.tasks.keypad.environment import Keypad
from tests.tasks.stylus import BUTTONS, above, play, press

SIZE = 96
CORNERS = [(0.5 + x, y, 0.046) for x in (-0.075, 0.075) for y in (-0.075, 0.075)]  # of the frame


@pytest.fixture(scope="module")
def home():
    """qpos with the stylus above the middle, at 0.09."""
    env = Keypad()
    env.reset(seed=0)
    return env._data.qpos.copy()


def project(camera, point, size=SIZE, tip=(0.5, 0.0, 0.09)):
    """Row and column at which a pinhole sees a point; the wrist camera is 7 cm before and 18 above the tip."""
    position, target, up, fovy = {
        "third_person": ([0.98, 0, 0.5], [0.5, 0, 0.06], [0, 0, 1], 19),
        "wrist": (np.add(tip, [0.07, 0, 0.18]), np.add(tip, [0.015, 0, 0]), [1, 0, 0], 52),
    }[camera]
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    down = np.cross(forward, right)
    offset = np.subtract(point, position)
    scale = size / 2 / np.tan(np.radians(fovy / 2)) / (offset @ forward)
    return int(size / 2 + scale * (offset @ down)), int(size / 2 + scale * (offset @ right))


def colour(frame, camera, point):
    """Mean colour of 3 x 3 pixels around a point."""
    row, column = project(camera, point, len(frame))
    return frame[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3).astype(float).mean(axis=0)


def draw(qpos, camera, lights=(), pressed=(), size=SIZE):
    qpos = qpos.copy()
    qpos[7 + np.array(pressed, dtype=int)] = 0.008
    return scene.draw(qpos, np.isin(np.arange(9), lights), camera, size)


@pytest.mark.parametrize("camera", ["third_person", "wrist"])
def test_the_whole_keypad_is_in_view_from_home(home, camera):
    frame = draw(home, camera, size=256)
    assert frame.shape == (256, 256, 3) and frame.dtype == np.uint8
    for corner in CORNERS:
        assert all(4 <= place < 252 for place in project(camera, corner, 256))
        assert colour(frame, camera, corner).max() < 110  # the frame is dark, the table is not
    for x, y in (BUTTONS[0], BUTTONS[2], BUTTONS[6], BUTTONS[8]):
        assert colour(frame, camera, (x, y, 0.04)).min() > 140


def well(camera, button):
    """Lowest and highest (row, column) of a button's well in a frame, a pixel more all around."""
    x, y = BUTTONS[button]
    corners = [(x + dx, y + dy, z) for dx in (-0.021, 0.021) for dy in (-0.021, 0.021) for z in (0.02, 0.046)]
    places = np.array([project(camera, corner) for corner in corners])
    return places.min(axis=0) - 1, places.max(axis=0) + 1


@pytest.mark.parametrize("camera", ["third_person", "wrist"])
@pytest.mark.parametrize("button", range(9))
def test_a_lit_button_and_a_pressed_button_look_different_where_they_are(home, camera, button):
    dark, lit, pressed = draw(home, camera), draw(home, camera, lights=[button]), draw(home, camera, pressed=[button])
    for other, least in ((lit, 40), (pressed, 8)):
        changed = np.argwhere(np.abs(other.astype(int) - dark).max(axis=2) > 20)
        assert len(changed) >= least
        lowest, highest = well(camera, button)
        assert (changed >= lowest).all() and (changed <= highest).all()
    red, _, blue = lit[np.abs(lit.astype(int) - dark).max(axis=2) > 60].mean(axis=0)
    assert red > 180 and red > 3 * blue  # it glows yellow


@pytest.mark.parametrize("camera", ["third_person", "wrist"])
def test_the_stylus_is_blue_not_black(home, camera):
    frame = draw(home, camera, size=192)
    for up in (0.01, 0.03, 0.05):
        red, green, blue = colour(frame, camera, (0.5, 0.0, 0.09 + up))
        assert blue > 110 and blue > 1.5 * green and blue > 3 * red


@pytest.mark.parametrize("button", range(9))
def test_the_hand_hides_no_button_while_one_is_pressed(button):
    env = Keypad(image_size=SIZE)
    play(env, above(button), above(button, 0.036), options={"mode": f"{button} 0 0"})
    frame = env.render()
    for other, (x, y) in enumerate(BUTTONS):
        if y != BUTTONS[button][1]:  # those behind it the stylus may hide
            assert colour(frame, "third_person", (x, y, 0.04)).min() > 140, other


def test_frames_never_show_which_button_is_due():
    env = Keypad(obs_type="pixels_agent_pos", image_size=48)
    points = [*press(4), *press(0)]
    one, _ = play(env, *points, options={"mode": "4 0 1"})
    other, _ = play(env, *points, options={"mode": "4 0 8"})
    third, _ = play(env, *press(4), options={"mode": "4 5 8"})
    assert not np.array_equal(one[-1]["goal"], other[-1]["goal"])
    for observations in (other, third):
        for a, b in zip(one, observations, strict=False):
            assert all(np.array_equal(a["pixels"][camera], b["pixels"][camera]) for camera in scene.CAMERAS)
    first, last = one[0]["pixels"], one[-1]["pixels"]
    assert set(first) == {"third_person", "wrist"}
    assert all(not np.array_equal(first[camera], last[camera]) for camera in first)


def test_frames_show_the_lights_of_their_own_environment():
    """All environments of a process draw from one scene."""
    dark, lit = (Keypad(obs_type="pixels_agent_pos", image_size=48, mode="4 0 8") for _ in range(2))
    before = dark.reset(seed=0)[0]["pixels"]["third_person"]
    play(lit, *press(4), seed=0)
    assert np.array_equal(dark.render(), before)
    assert not np.array_equal(lit.render(), before)
