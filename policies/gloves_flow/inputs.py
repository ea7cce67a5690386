"""What goes into a flow, checked and made of one type before it is normalised."""

import json
from dataclasses import dataclass, field
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.processor import (
    DeviceProcessorStep,
    EnvTransition,
    ProcessorStep,
    ProcessorStepRegistry,
    TransitionKey,
    make_default_pre_post_processors,
)
from torch import Tensor
from torchvision.transforms import functional

COLOURS = 3
"""Channels of an image."""
BRIGHTEST = 2.0
"""Colours lie in [0, 1]; what lies far beyond is something else, such as a depth camera's millimetres."""


def excluding(*keys: str) -> str:
    """The option that trains a flow without some observations."""
    return f"--policy.exclude_features='{json.dumps(sorted({*keys}))}'"


@ProcessorStepRegistry.register("gloves_flow_inputs")
@dataclass
class FlowInputs(ProcessorStep):
    """Refuses what a flow cannot read, and makes floats of single precision of the rest, actions too.

    Normalising would make the statistics of another type instead: whole ones, where an observation is a whole number.

    Attributes:
        cameras: Observation keys of the images that the flow reads.
        states: Those of all else that it reads.
        excluded: Those that it was told to leave out.
        sizes: Height and width of the images that the flow was trained on, in pixels, by key; others are resized to it,
            as LeRobot's processor step does.
    """

    cameras: list[str] = field(default_factory=list)
    states: list[str] = field(default_factory=list)
    excluded: list[str] = field(default_factory=list)
    sizes: dict[str, list[int]] = field(default_factory=dict)

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """See `ProcessorStep`.

        Raises:
            ValueError: If an observation is not of numbers, or an image not of colours; says what to exclude.
        """
        observation = dict(transition.get(TransitionKey.OBSERVATION) or {})
        for key in (*self.states, *self.cameras):
            value = observation.get(key)
            if value is None:
                continue
            if not isinstance(value, Tensor):
                raise ValueError(f"{key} holds no numbers: train without it, {excluding(key, *self.excluded)}")
            brightest = float(value.max()) if key in self.cameras and value.numel() else 0.0
            if brightest > BRIGHTEST:
                raise ValueError(
                    f"{key} holds values up to {brightest:g}, but colours lie between 0 and 1: if it is a depth "
                    f"camera, train without it, {excluding(key, *self.excluded)}"
                )
            value = value.to(torch.float32)
            observation[key] = _resized(value, self.sizes[key]) if key in self.sizes else value
        made = {**transition, TransitionKey.OBSERVATION: observation}
        action = transition.get(TransitionKey.ACTION)
        if isinstance(action, Tensor):
            made[TransitionKey.ACTION] = action.to(torch.float32)
        return made

    def get_config(self) -> dict[str, Any]:
        return {"cameras": self.cameras, "states": self.states, "excluded": self.excluded, "sizes": self.sizes}

    def transform_features(self, features: Any) -> Any:
        return features


def _resized(image: Tensor, size: list[int]) -> Tensor:
    """Images (..., H, W) in [0, 1] of that height and width."""
    if list(image.shape[-2:]) == size:
        return image
    return functional.resize(image, size).clamp(0.0, 1.0)


def make_flow_pre_post_processors(config: PreTrainedConfig, dataset_stats: Any = None, **options: Any) -> Any:
    """LeRobot's default pipelines (rename, batch, device, normalise; and back), with `FlowInputs` before the device."""
    before, behind = make_default_pre_post_processors(config, dataset_stats, **options)
    features: dict[str, PolicyFeature] = config.input_features or {}
    cameras = [key for key, feature in features.items() if feature.type is FeatureType.VISUAL]
    states = [key for key in features if key not in cameras]
    place = next(i for i, step in enumerate(before.steps) if isinstance(step, DeviceProcessorStep))
    sizes = {key: list(features[key].shape[1:]) for key in cameras}
    before.steps.insert(place, FlowInputs(cameras, states, list(getattr(config, "exclude_features", [])), sizes))
    return before, behind
