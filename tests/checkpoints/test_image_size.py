"""A policy that is shown larger images than it was trained on."""

import pytest
import torch
from lerobot.processor import ImageCropResizeProcessorStep

from lerobot_gloves.checkpoints.image_size import resize_images
from tests.builders import CAMERA, SIZE, load, observation, save_policy

BY_LEROBOT = ImageCropResizeProcessorStep(resize_size=(SIZE, SIZE))


def shown() -> dict[str, torch.Tensor]:
    large = observation(obs_type="pixels_agent_pos")
    large[CAMERA] = torch.rand(2, 3, 3 * SIZE, 2 * SIZE, generator=torch.Generator().manual_seed(1))
    return large


def test_an_agent_reduces_them_first_if_its_checkpoint_says_so(tmp_path):
    folder = save_policy(tmp_path / "agent", "act", "pixels_agent_pos")
    policy, (before, _) = load(folder)
    wanted = policy.select_action(before(BY_LEROBOT.observation(shown())))
    for _ in range(2):  # twice is once
        resize_images(folder)
    policy, (before, _) = load(folder)
    assert torch.equal(policy.select_action(before(shown())), wanted)
    assert sum(isinstance(step, ImageCropResizeProcessorStep) for step in before.steps) == 1
    with pytest.raises(ValueError, match="sees images of 0 sizes"):
        resize_images(save_policy(tmp_path / "blind", "gloves_expert_flow"))


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_copilot"])
def test_a_flow_reduces_them_by_itself(tmp_path, kind):
    _, (before, _) = load(save_policy(tmp_path / "flow", kind, "pixels_agent_pos"))
    assert torch.equal(before(shown())[CAMERA], before(BY_LEROBOT.observation(shown()))[CAMERA])
    assert before(shown())[CAMERA].shape == (2, 3, SIZE, SIZE)
