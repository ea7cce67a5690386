"""Encoders of the context (paper, appendix "Visual and State Encoders")."""

from contextlib import nullcontext

import torch
from torch import Tensor, nn
from torchvision.models import ResNet18_Weights, get_model
from torchvision.ops import FrozenBatchNorm2d


class StateEncoder(nn.Module):
    """Three-layer feedforward network from a vector (B, S) to one context token (B, 1, d_c).

    Normalised inputs are stretched first. What decides an action (on which side of a pillar, before or after a turn) is
    often a hundredth of an input's range, and a network whose weights start small takes long to tell such inputs apart.

    Args:
        state_dim: S.
        context_dim: d_c.
        width: Hidden width.
        stretch: Factor on the normalised inputs.
    """

    def __init__(self, state_dim: int, context_dim: int, width: int = 256, stretch: float = 4.0):
        super().__init__()
        self.stretch = stretch
        self.layers = nn.Sequential(
            nn.Linear(state_dim, width), nn.GELU(), nn.Linear(width, width), nn.GELU(), nn.Linear(width, context_dim)
        )

    def forward(self, state: Tensor) -> Tensor:
        """Vectors (B, S) to tokens (B, 1, d_c)."""
        return self.layers(self.stretch * state)[:, None]


def _group_norm(channels: int) -> nn.GroupNorm:
    """Groups of 16 channels, as Diffusion Policy trains a ResNet from none."""
    return nn.GroupNorm(channels // 16, channels)


NORMS = {"frozen_batch": FrozenBatchNorm2d, "group": _group_norm}
"""What normalises inside an image encoder, by name. The paper's frozen batch norm rests on statistics that come with
pretrained weights; without them it would do nothing, and a ResNet without normalisation hardly learns."""

DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}
"""What an image encoder can compute in, by name: half the bits are two to three times as fast where the processor has
instructions for them."""


class ImageEncoder(nn.Module):
    """ResNet-18 up to its third stage and a 1 x 1 projection.

    Args:
        context_dim: d_c.
        norm: One of `NORMS`.
        dtype: One of `DTYPES`, that it computes in; its weights, images and tokens are of the types that they are of.

    Raises:
        ValueError: If there is no such norm or type.
    """

    stride = 16
    channels = 256

    def __init__(self, context_dim: int, norm: str | None = "frozen_batch", dtype: str = "float32"):
        super().__init__()
        if norm is None or norm not in NORMS:
            raise ValueError(f"an image encoder has no norm {norm!r}: choose from {', '.join(NORMS)}")
        if dtype not in DTYPES:
            raise ValueError(f"an image encoder does not compute in {dtype!r}: choose from {', '.join(DTYPES)}")
        self.dtype = DTYPES[dtype]
        net = get_model("resnet18", weights=None, norm_layer=NORMS[norm])
        self.backbone = nn.Sequential(net.conv1, net.bn1, net.relu, net.maxpool, net.layer1, net.layer2, net.layer3)
        self.project = nn.Conv2d(self.channels, context_dim, kernel_size=1)

    def load_pretrained(self, weights: str) -> None:
        """Fill the backbone from torchvision's store, say "ResNet18_Weights.IMAGENET1K_V1".

        Raises:
            OSError: If the weights cannot be fetched or are damaged; the message names the option that does without.
            ValueError: If there are no weights of that name.
        """
        choices = {f"ResNet18_Weights.{name}": choice for name, choice in ResNet18_Weights.__members__.items()}
        if weights not in choices:
            raise ValueError(f"the image encoder knows no weights {weights!r}: choose from {', '.join(choices)}")
        try:
            state = choices[weights].get_state_dict(progress=False, check_hash=True)
        except (OSError, RuntimeError) as error:  # torch's, if the hash is wrong or the file no checkpoint
            reason = " ".join(str(error).split())
            raise OSError(
                f"cannot fetch the image encoder's weights {weights} ({reason}): go online once, put the file into "
                f"{torch.hub.get_dir()}/checkpoints, or train without them by "
                "--policy.pretrained_backbone_weights=null"
            ) from error
        net = get_model("resnet18", weights=None, norm_layer=FrozenBatchNorm2d)
        net.load_state_dict(state, strict=False)  # Frozen batch norm counts no batches.
        source = nn.Sequential(net.conv1, net.bn1, net.relu, net.maxpool, net.layer1, net.layer2, net.layer3)
        self.backbone.load_state_dict(source.state_dict())

    def forward(self, image: Tensor) -> Tensor:
        """Normalised images (B, 3, H, W) to context tokens (B, H / 16 * W / 16, d_c)."""
        image = image.contiguous(memory_format=torch.channels_last)  # convolutions are a sixth faster on it
        half = self.dtype is not torch.float32  # else whatever surrounds it, such as accelerate's, has its say
        with torch.autocast(image.device.type, self.dtype) if half else nullcontext():
            tokens = self.project(self.backbone(image))
        return (tokens.to(image.dtype) if half else tokens).flatten(2).transpose(1, 2)
