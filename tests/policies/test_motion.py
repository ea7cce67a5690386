"""Which environments of a batch still run, guessed by what they show: the log and the totals of the wrapper."""

import json

import pytest
import torch

from lerobot_policy_gloves.gloves.motion import Motion
from tests.builders import calibrate, save_policy, wrap

CAMERA, SIZE, STEPS = "observation.images.front", 64, 30
WINDOW = 5
"""Actions that the agent executes of a chunk."""


@pytest.fixture(scope="module")
def seeing(tmp_path_factory):
    """An agent and an adapter that see images alone."""
    folder = tmp_path_factory.mktemp("seeing")
    adapter = save_policy(folder / "adapter", "gloves_expert_flow", "pixels_agent_pos", seed=7)
    return save_policy(folder / "agent", "act", "pixels_agent_pos"), calibrate(adapter)


def frames(moving: list[range], *, amount: float = 1 / 255) -> list[dict[str, torch.Tensor]]:
    """What environments show for a while: one pixel of the image changes by a grey level at the steps in `moving`."""
    image = torch.rand(len(moving), 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    shown = []
    for step in range(STEPS):
        for row, steps in enumerate(moving):
            if step in steps:
                image[row, 1, 37, 23] += amount
        shown.append({CAMERA: image.clone(), "observation.state": torch.zeros(len(moving), 4)})
    return shown


def steps_in_the_log(seeing, shown, path, **changes) -> list[list[int]]:
    agent, adapter = seeing
    policy = wrap(agent, adapter=adapter, method="none", log=path)
    with torch.inference_mode():
        for observation in shown:
            policy.select_action(observation)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert policy.statistics()["chunks"] == len(lines)
    return [[line["step"] for line in lines if line["episode"] == row] for row in range(len(shown[0][CAMERA]))]


EVERY = list(range(0, STEPS, WINDOW))


@pytest.mark.parametrize("amount", [1 / 255, 0.0])
def test_little_motion_in_images_alone_counts(seeing, tmp_path, amount):
    """A pixel that no sample of an image holds, or nothing that a camera could see: twelve chunks either way."""
    shown = frames([range(1, STEPS)] * 2, amount=amount)
    assert steps_in_the_log(seeing, shown, tmp_path / "log") == [EVERY, EVERY]


def test_one_that_waits_and_moves_again_was_running_all_the_time(seeing, tmp_path):
    waits = set(range(1, STEPS)) - set(range(8, 23))
    shown = frames([range(1, STEPS), waits])
    first, second = steps_in_the_log(seeing, shown, tmp_path / "log")
    assert first == EVERY and sorted(second) == EVERY


def test_one_that_never_moves_again_is_over(seeing, tmp_path):
    """As LeRobot freezes it: the observation after its last step is shown until the others have ended."""
    shown = frames([range(1, STEPS), range(1, 13), range(0)])
    assert steps_in_the_log(seeing, shown, tmp_path / "log") == [EVERY, [0, 5, 10], EVERY]


def test_an_observation_that_is_written_over_is_seen_to_change():
    """Two of three move in one buffer, the third stops after step 2."""
    motion, buffer = Motion(), torch.zeros(3, 2)
    for step in range(6):
        buffer[:2] = step
        buffer[2] = min(step, 2)
        motion.see({"observation.state": buffer}, 3)
    assert [motion.over(row) for row in range(3)] == [False, False, True]


def test_new_episodes_forget_what_stood_still(seeing, tmp_path):
    agent, adapter = seeing
    policy = wrap(agent, adapter=adapter, method="none", log=tmp_path / "log")
    with torch.inference_mode():
        for observation in frames([range(1, STEPS), range(1, 3)]):
            policy.select_action(observation)
        policy.reset()
        for observation in frames([range(1, STEPS), range(1, STEPS)]):
            policy.select_action(observation)
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [sum(line["episode"] == episode for line in lines) for episode in range(4)] == [6, 1, 6, 6]
