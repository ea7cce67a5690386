"""What an environment shows, under the keys and in the form in which a dataset holds it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from lerobot.envs import EnvConfig, preprocess_observation
from lerobot.processor import ImageCropResizeProcessorStep
from lerobot.utils.constants import OBS_IMAGE, OBS_STR
from torch import Tensor


def columns(
    env_config: EnvConfig, observation: Mapping[str, Any], image_size: int | None = None
) -> dict[str, np.ndarray]:
    """What a policy gets to see of B environments, under LeRobot's keys; of anything else a dataset is no use to it.

    Args:
        env_config: The task. Without processors of its own it names, in `features_map`, the observations that policies
            may use: it may show its expert more.
        observation: As its vector environment returns it: vectors and, under `pixels`, one image or several by name.
        image_size: Height and width of the images that are kept, in pixels, resized as LeRobot's processor step for a
            policy does; None for those that are observed.

    Returns:
        Vectors and other tensors (B, ...), float32, and images (B, H, W, 3), uint8.
    """
    before, _ = env_config.get_env_processors()
    seen = before(preprocess_observation(dict(observation)))
    if image_size is not None:
        seen = ImageCropResizeProcessorStep(resize_size=(image_size, image_size)).observation(seen)
    known = set(env_config.features_map.values())
    return {
        key: _bytes(value) if key.startswith(OBS_IMAGE) else value.numpy()
        for key, value in seen.items()
        if key.startswith(OBS_STR) and isinstance(value, Tensor) and (before.steps or key in known)
    }


def single(
    env_config: EnvConfig, observation: Mapping[str, Any], image_size: int | None = None
) -> dict[str, np.ndarray]:
    """The same of an environment that stands alone, without a dimension for the batch."""
    return {key: values[0] for key, values in columns(env_config, _batched(observation), image_size).items()}


def _batched(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _batched(one) for key, one in value.items()}
    return np.asarray(value)[None]


def _bytes(images: Tensor) -> np.ndarray:
    """Images (B, 3, H, W) in [0, 1] as LeRobot makes them of bytes, made bytes (B, H, W, 3) again, exactly."""
    return (images * 255).round().byte().movedim(1, -1).numpy()
