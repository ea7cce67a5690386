"""What CAN's cameras show."""

import numpy as np

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.tasks.can import scene
from lerobot_gloves.tasks.can.environment import Can
from lerobot_gloves.tasks.panda import HOME

SIZE = 96
PLACES = {"top left": (0.0, 0.16), "top right": (0.0, 0.4), "bottom left": (0.2, 0.16), "bottom right": (0.2, 0.4)}


def frame(camera, can, fingers=0.04, arm=HOME):
    """A frame with the can standing at (x, y) or hovering at (x, y, z)."""
    position = [*can, 0.86][:3]
    return scene.draw(np.array([*arm, fingers, -fingers, *position, 1, 0, 0, 0]), camera, SIZE).astype(int)


def red(image):
    """Which pixels are red: only the can is."""
    return (image[..., 0] > 80) & (image[..., 0] > 2.5 * image[..., 1]) & (image[..., 0] > 2.5 * image[..., 2])


def project(point):
    """Row and column at which a pinhole at (1, 0, 1.75) with 45 degrees of view, looking 45 degrees down, sees it."""
    offset = np.array(point) - [1.0, 0.0, 1.75]
    forward, right, up = np.array([-1, 0, -1]) / np.sqrt(2), np.array([0, 1, 0]), np.array([-1, 0, 1]) / np.sqrt(2)
    scale = SIZE / 2 / np.tan(np.pi / 8) / (offset @ forward)
    return np.array([SIZE / 2 - scale * (offset @ up), SIZE / 2 + scale * (offset @ right)])


def test_the_third_person_view_shows_the_can_in_every_quadrant_where_its_name_says():
    seen = {}
    for name, (x, y) in PLACES.items():
        image = frame("third_person", (x, y))
        assert red(image).sum() >= 8
        seen[name] = np.argwhere(red(image)).mean(axis=0)
        assert np.abs(seen[name] - project((x, y, 0.87))).max() < 3
        # Without the can the place shows the bin's wood, neither black nor red.
        row, column = np.round(seen[name]).astype(int)
        empty = frame("third_person", (0.1, -0.25))[row - 1 : row + 2, column - 1 : column + 2]
        assert not red(empty).any() and empty.mean() > 15
    (top, left), (bottom, right) = seen["top left"], seen["bottom right"]
    assert top < bottom - 5 and left < right - 5
    assert seen["top right"][0] < bottom - 5 and seen["top right"][1] > left + 5
    assert seen["bottom left"][0] > top + 5 and seen["bottom left"][1] < right - 5


def test_the_third_person_view_shows_the_can_wherever_it_starts():
    for x, y in ((-0.02, -0.42), (0.22, -0.42), (-0.02, -0.08), (0.22, -0.08)):
        image = frame("third_person", (x, y))
        assert red(image).sum() >= 8
        assert np.abs(np.argwhere(red(image)).mean(axis=0) - project((x, y, 0.87))).max() < 3


def test_the_wrist_view_shows_the_fingers_and_the_can_between_them():
    opened, closed = (frame("wrist", (0.1, -0.25, 0.5), fingers=fingers) for fingers in (0.04, 0.0))
    differ = np.abs(opened - closed).sum(axis=-1) > 30
    rows, columns = np.nonzero(differ)
    assert differ.sum() > 50 and rows.min() > SIZE / 2  # the fingers move, in the lower half
    assert columns.min() < SIZE / 3 and columns.max() > 2 * SIZE / 3  # from both sides
    assert opened.mean() > 50 and opened[-8:].mean() > 20  # the hand is at the bottom, not black
    env = Can()
    grip = env._observation()["agent_pos"][:3]
    held = scene.draw(np.array([*env._data.qpos[:7], 0.025, -0.025, *(grip - [0, 0, 0.02]), 1, 0, 0, 0]), "wrist", SIZE)
    assert red(held.astype(int))[SIZE // 2 :, SIZE // 3 : 2 * SIZE // 3].mean() > 0.15
    assert not red(opened).any()


def test_frames_never_show_the_requested_quadrant():
    env = Can(obs_type="pixels_agent_pos", image_size=SIZE)
    one, _ = env.reset(seed=0, options={"mode": "top left"})
    other, _ = env.reset(seed=0, options={"mode": "bottom right"})
    assert set(one["pixels"]) == {"third_person", "wrist"}
    for camera, image in one["pixels"].items():
        assert np.array_equal(image, other["pixels"][camera])
    assert not np.array_equal(one["goal"], other["goal"])
    assert np.array_equal(env.render(), other["pixels"]["third_person"])
