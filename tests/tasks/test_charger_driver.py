"""Charger in a process of its own, on a machine without a Vulkan driver."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from lerobot_gloves.tasks.charger.environment import Charger

PLAY = """
import numpy as np
observation, _ = env.reset(seed=11)
seen = [*observation.values()]
for action in np.random.default_rng(0).uniform(-0.5, 0.5, (80, 8)).astype(np.float32):
    seen += env.step(action)[0].values()
"""
ALONE = f"""
import sys, warnings, hashlib
import lerobot_policy_gloves, lerobot_gloves.tasks
assert not {{"sapien", "mani_skill", "mplib", "mujoco", "robosuite", "OpenGL"}} & sys.modules.keys()
from lerobot_gloves.tasks.charger.environment import Charger
env = Charger(image_size=32)
{PLAY}
print(hashlib.sha256(np.concatenate(seen)).hexdigest())
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    frames = [env.render() for _ in range(2)]
assert [(frame.shape, frame.max()) for frame in frames] == [((32, 32, 3), 0)] * 2
print(*(warning.message for warning in said))
try:
    Charger(obs_type="pixels_agent_pos").reset(seed=0)
except RuntimeError as error:
    print(error)
assert "mplib" not in sys.modules
"""


@pytest.mark.slow
def test_states_need_no_driver_pictures_say_which_and_two_processes_play_alike():
    env = Charger()
    names: dict = {"env": env}
    exec(PLAY, names)
    digest = hashlib.sha256(np.concatenate(names["seen"])).hexdigest()
    nowhere = {"VK_ICD_FILENAMES": os.devnull, "VK_DRIVER_FILES": os.devnull}
    done = subprocess.run(
        [sys.executable, "-c", ALONE], capture_output=True, text=True, check=True, env=os.environ | nowhere
    )
    there, rendered, refused = done.stdout.splitlines()
    assert done.stderr == ""
    assert there == digest
    assert rendered.startswith("frames are black: ") and rendered.count("frames are black") == 1
    for line in (rendered, refused):
        assert "needs a Vulkan driver" in line and "apt-get install mesa-vulkan-drivers" in line
