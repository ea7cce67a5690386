import numpy as np
import pytest

from lerobot_gloves.demo.replay import replay
from lerobot_gloves.tasks.slalom.scene import GOAL_Y, PILLAR_RADII, PILLARS, ROD_RADIUS
from tests.demo.episodes import RAW, played


def test_a_replay_ends_where_the_recording_stops():
    result = played(RAW, [10005])
    path = replay(result, 0, 10005)
    np.testing.assert_array_equal(path.tips[:-1], result.set_points_and_tips[0][:, 2:])
    assert path.failure == "" and path.tips[-1, 1] > GOAL_Y >= path.tips[-2, 1]
    assert path.frames is None


def test_a_replay_knows_why_an_episode_failed():
    path = replay(played(RAW, [10000], straight=True), 0, 10000)
    assert path.failure == "collision"
    reach = np.linalg.norm(path.tips[-1] - PILLARS[0]) - PILLAR_RADII[0] - ROD_RADIUS
    assert abs(reach) < 0.008  # one step


@pytest.mark.parametrize("spoilt", ["actions", "successes"])
def test_another_episode_than_the_recorded_one_is_noticed(spoilt):
    result = played(RAW, [10000])
    if spoilt == "actions":
        result.actions[0][3] = 0.0
    else:
        result.successes[0] = False
    with pytest.raises(RuntimeError, match="raw agent, seed 10000: the simulator did not repeat"):
        replay(result, 0, 10000)


def test_frames_follow_the_rod():
    result = played(RAW, [10000], straight=True)
    frames = replay(result, 0, 10000, image_size=48).frames
    assert frames.shape == (len(result.actions[0]) + 1, 48, 48, 3) and frames.dtype == np.uint8
    assert (frames[0] != frames[-1]).any()
