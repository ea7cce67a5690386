"""What Charger's cameras show, where a Vulkan driver draws them."""

import numpy as np
import pytest

from lerobot_gloves.tasks.charger import drawing, simulator
from lerobot_gloves.tasks.charger.environment import Charger

SIZE = 64
pytestmark = pytest.mark.slow  # a software driver takes some ten seconds until the first frame


@pytest.fixture(scope="module", autouse=True)
def driver():
    if problem := drawing.missing_driver():
        pytest.skip(problem)


@pytest.fixture(scope="module")
def env():
    return Charger(obs_type="pixels_agent_pos", image_size=SIZE, privileged=True)


def test_the_wrist_camera_shows_what_maniskills_shows(env):
    raw = simulator.plug_charger(
        obs_mode="rgb", render_backend=drawing._device(), sensor_configs={"width": SIZE, "height": SIZE}
    )
    theirs, _ = raw.reset(seed=3)
    ours, _ = env.reset(seed=3)
    for _ in range(2):
        picture = theirs["sensor_data"]["hand_camera"]["rgb"][0].numpy().astype(int)
        assert picture.std() > 10
        assert ours["pixels"].keys() == {"wrist"}
        assert ours["pixels"]["wrist"].dtype == np.uint8
        assert np.abs(ours["pixels"]["wrist"] - picture).mean() < 1
        for _ in range(8):
            action = np.array([0.3, -0.2, 0, 0, 0.2, 0, 0.5, -1.0], dtype=np.float32)
            theirs, *_ = raw.step(action)
            ours, *_ = env.step(action)


def test_pictures_do_not_change_what_happens(env):
    blind = Charger()
    one, _ = env.reset(seed=5)
    other, _ = blind.reset(seed=5)
    for action in np.random.default_rng(0).uniform(-0.5, 0.5, (10, 8)).astype(np.float32):
        assert np.array_equal(one["agent_pos"], other["agent_pos"])
        assert np.array_equal(one["environment_state"], other["environment_state"])
        one, *_ = env.step(action)
        other, *_ = blind.step(action)


def test_a_state_environment_renders_too_and_each_shows_its_own_scene(env):
    other = Charger(image_size=SIZE)
    env.reset(seed=1)
    other.reset(seed=2)
    mine = env.render()
    assert mine.shape == (SIZE, SIZE, 3) and mine.std() > 10
    assert np.abs(mine.astype(int) - other.render()).mean() > 3
    assert np.array_equal(env.render(), mine)
