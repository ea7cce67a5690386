"""What a flow's image encoders start from: nothing, ImageNet, or the encoders of a flow that has seen these cameras."""

from pathlib import Path
from typing import Any

from huggingface_hub.errors import HFValidationError
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.checkpoints.loading import load_weights
from lerobot_gloves.networks import VelocityNetwork

from .configuration_flow import FlowConfig

OPTION = "--policy.pretrained_backbone_weights"
TORCHVISION = "ResNet18_Weights."
"""How torchvision's names for weights begin; any other name is a checkpoint's."""


def fill_in_normalisation(config: FlowConfig) -> None:
    """Say how the encoders normalise, where the configuration does not: as the weights that they start from.

    Raises:
        ValueError: If those are no torchvision weights and no flow's.
    """
    weights = config.pretrained_backbone_weights
    if config.backbone_norm is not None or not config.image_features:
        return
    if weights is None:
        config.backbone_norm = "group"
    else:
        config.backbone_norm = (
            "frozen_batch" if weights.startswith(TORCHVISION) else _source(weights, config).backbone_norm
        )


def start(network: VelocityNetwork, config: FlowConfig) -> None:
    """Fill the encoders' backbones with the weights that the configuration names, if it names any.

    Raises:
        OSError: If torchvision's weights cannot be fetched.
        ValueError: If they are another network's, or of a flow that has not seen one of the cameras.
    """
    weights = config.pretrained_backbone_weights
    if weights is None:
        return
    if weights.startswith(TORCHVISION):
        for encoder in network.image_encoders:
            encoder.load_pretrained(weights)
        return
    source = _source(weights, config)
    if source.backbone_norm != config.backbone_norm:
        raise ValueError(
            f"{OPTION}={weights} normalises by {source.backbone_norm!r}, but --policy.backbone_norm is "
            f"{config.backbone_norm!r}: leave that out"
        )
    source.pretrained_path, source.device = Path(weights), "cpu"
    flow: Any = load_weights(source, merged=True)
    seen = dict(zip(flow.averaged.cameras, flow.averaged.image_encoders, strict=True))
    for camera, encoder in zip(network.cameras, network.image_encoders, strict=True):
        encoder.backbone.load_state_dict(seen[camera].backbone.state_dict())


def _source(weights: str, config: FlowConfig) -> FlowConfig:
    """The configuration of the flow whose encoders are meant, which has seen all cameras."""
    try:
        source = PreTrainedConfig.from_pretrained(weights)
    except (FileNotFoundError, HFValidationError) as error:
        raise ValueError(
            f"{OPTION}={weights} is neither one of torchvision's, such as {TORCHVISION}IMAGENET1K_V1, nor a "
            "checkpoint's folder, nor one on the Hub in reach"
        ) from error
    if not isinstance(source, FlowConfig):
        raise ValueError(f"{OPTION}={weights} is of type {source.type!r}, whose image encoders are no flow's")
    unseen = sorted(set(config.image_features) - set(source.image_features))
    if unseen:
        raise ValueError(f"{OPTION}={weights} has not seen {', '.join(unseen)}: start from a flow of the same cameras")
    return source
