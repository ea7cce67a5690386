import cv2
import numpy as np
import pytest

from lerobot_gloves.demo import video
from lerobot_gloves.demo.replay import Path2d, replay
from lerobot_gloves.tasks.slalom.scene import GOAL_Y, PILLAR_HEIGHT, PILLARS
from tests.demo.episodes import RAW, played


@pytest.fixture(scope="module")
def path() -> Path2d:
    result = played(RAW, [10000], straight=True)
    result.actions[0] = result.actions[0][:3]
    result.set_points_and_tips[0] = result.set_points_and_tips[0][:3]
    return replay(result, 0, 10000, image_size=video.RENDERED)


def colour(frame, point):
    ((column, row),) = video._pixels(np.array([point]))
    return frame[round(row), round(column)].astype(int)


def test_points_are_drawn_where_the_camera_sees_them(path):
    for x, y in PILLARS[1:]:  # the arm hides the first one
        red, green, _ = colour(path.frames[0], [x, y, PILLAR_HEIGHT])
        assert red > 150 > 100 > green
        red, green, _ = colour(path.frames[0], [x, y - 0.06, 0])
        assert abs(red - green) < 40
    for x in (0.25, 0.5, 0.75):
        red, green, _ = colour(path.frames[0], [x, GOAL_Y, 0])
        assert green > red + 60
        red, green, _ = colour(path.frames[0], [x, GOAL_Y + 0.02, 0])
        assert abs(red - green) < 40


def test_nothing_is_drawn_over_pillars_and_arm(path):
    table = video._table(path.frames[0])
    ((column, row),) = video._pixels(np.array([[*PILLARS[4], PILLAR_HEIGHT]]))
    assert table[round(row), round(column)] == 0
    ((column, row),) = video._pixels(np.array([[0.7, 0.0, 0.0]]))
    assert table[round(row), round(column)] == 255
    for base in ([0.05, 0, 0.1], [0, 0, 0.3]):  # of the arm: black, white
        ((column, row),) = video._pixels(np.array([base]))
        assert table[round(row), round(column)] == 0


def test_both_sides_are_written_and_the_shorter_one_waits(path, tmp_path):
    longer = Path2d(path.tips, "", path.frames)
    shorter = Path2d(path.tips[:2], "collision", path.frames[:2])
    panels = [video.Panel("raw agent", shorter, [False]), video.Panel("FEEG", longer, [True, True, False])]
    video.write(panels, "0 0 0", "a caption", tmp_path / "both.mp4")
    capture = cv2.VideoCapture(str(tmp_path / "both.mp4"))
    frames = []
    while (got := capture.read())[0]:
        frames.append(got[1].astype(int))
    assert len(frames) == 4 + round(video.HOLD * 20) and capture.get(cv2.CAP_PROP_FPS) == 20
    half = video.SHOWN
    assert frames[0].shape[1] == 2 * half + video.GUTTER
    body = slice(video.HEADER, -video.FOOTER)
    left = [frame[body, :half] for frame in frames]
    right = [frame[body, -half:] for frame in frames]
    assert np.abs(left[1] - left[3]).mean() < 1.0  # waits at its end
    assert np.abs(right[1] - right[3]).max() > 40
    # The outcome appears in the header of the side whose episode is over: orange on the left.
    header = frames[-1][: video.HEADER, half // 2 : half]
    blue, _, red = np.moveaxis(header, -1, 0)
    assert (red - blue > 120).any()
    assert not (np.abs(frames[0][: video.HEADER, half // 2 : half] @ [1, 0, -1]) > 120).any()
