"""Checkpoints that reduce images to the size that they were trained on, wherever they are shown larger ones."""

from pathlib import Path

from lerobot.processor import ImageCropResizeProcessorStep
from lerobot.utils.constants import POLICY_PREPROCESSOR_DEFAULT_NAME

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.processors import load_processors


def resize_images(checkpoint: Path) -> None:
    """Have a checkpoint's preprocessor resize images first, by LeRobot's own step; done before, it is left as it is.

    LeRobot shows a policy an environment's images as they are, which are larger than those of a dataset that was
    recorded with `--dataset.image_size`.

    Args:
        checkpoint: Folder of any policy.

    Raises:
        ValueError: If it sees no images, or such of several sizes.
    """
    config = checkpoint_config("checkpoint", str(checkpoint))
    sizes = {tuple(feature.shape[1:]) for feature in config.image_features.values()}
    if len(sizes) != 1:
        raise ValueError(f"{checkpoint} sees images of {len(sizes)} sizes, but must of one to have them resized")
    before, _ = load_processors(config, str(checkpoint), config.device)
    if not any(isinstance(step, ImageCropResizeProcessorStep) for step in before.steps):
        before.steps = [ImageCropResizeProcessorStep(resize_size=sizes.pop()), *before.steps]
        before.save_pretrained(checkpoint, config_filename=f"{POLICY_PREPROCESSOR_DEFAULT_NAME}.json")
