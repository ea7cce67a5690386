"""Settings shared by the policies that are flows (paper, tables (a) and (b)).

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

import math
from dataclasses import dataclass, field

from lerobot.configs import NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim import AdamWConfig
from lerobot.optim.schedulers import LRSchedulerConfig

from .inputs import COLOURS, excluding


@dataclass
class FlowConfig(PreTrainedConfig):
    """Network, training and sampling of a flow. The defaults are the paper's table (a) and (b)."""

    # Actions in a chunk, T.
    chunk_size: int = 10
    # Actions executed before the next chunk is sampled.
    n_action_steps: int = 10

    # Width of a context token, d_c.
    context_dim: int = 256
    # Hidden width of the DiT, d.
    width: int = 128
    # Blocks of the DiT.
    depth: int = 4
    # Attention heads, H.
    heads: int = 4
    # Expansion of the MLP, r.
    mlp_ratio: int = 4
    # Dropout in the blocks.
    dropout: float = 0.1
    # Frequencies of the time embedding.
    time_dim: int = 256
    # What the image encoders start from: torchvision's weights by name, or the folder or Hub id of a flow that was
    # trained with the same cameras, on the same demonstrations say; null for none.
    pretrained_backbone_weights: str | None = "ResNet18_Weights.IMAGENET1K_V1"
    # What normalises in them: frozen_batch, the paper's, or group; null for what the weights have, group without any.
    backbone_norm: str | None = None
    # What they compute in: float32, or bfloat16, which trains about twice as fast on a GPU or a CPU that has it.
    backbone_dtype: str = "float32"

    # Probability p_cfg of training without the context (with a goal or a label: without that).
    context_dropout: float = 0.2
    # Probability p_vd of training without one of the views.
    visual_dropout: float = 0.1
    # Independent draws of noise and time for each loaded item, so that loading it and encoding its context are paid
    # once for so many flow samples.
    samples_per_item: int = 8
    # Decay of the averaged weights that inference uses; it warms up.
    ema_decay: float = 0.999

    # Euler steps that sample a chunk.
    num_inference_steps: int = 10
    # Classifier-free guidance at inference; 1 is off.
    guidance: float = 1.0
    # Seed of the noise that chunks are sampled from; with the episode's number it fixes an episode's draws.
    seed: int = 0

    # MIN_MAX sends an observation that never changes in the data to one constant exactly; dividing by its standard
    # deviation, 0, would blow rounding errors up.
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "VISUAL": NormalizationMode.MEAN_STD,
            "STATE": NormalizationMode.MEAN_STD,
            "ENV": NormalizationMode.MIN_MAX,
            "ACTION": NormalizationMode.MEAN_STD,
        }
    )

    # Base learning rate.
    optimizer_lr: float = 3e-4
    # Learning rate of the image encoders where they are pretrained; 0 leaves them as they are, which is twice as fast.
    optimizer_lr_backbone: float = 3e-5
    # Adam's betas.
    optimizer_betas: tuple[float, float] = (0.9, 0.999)
    # Weight decay.
    optimizer_weight_decay: float = 1e-3
    # Largest gradient norm.
    optimizer_grad_clip_norm: float = 1.0

    # What each entry of an action is; LeRobot fills it in from the dataset. null: nobody knows.
    action_feature_names: list[str] | None = None

    # Frames a second of the data, which training fills in; null: nobody knows.
    fps: float | None = None

    exclude_features: list[str] = field(default_factory=list)  # Observations that the flow is not conditioned on.

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ValueError(
                f"n_action_steps is {self.n_action_steps}, but must lie between 1 and chunk_size, {self.chunk_size}"
            )
        for name in ("context_dim", "width", "depth", "heads", "mlp_ratio", "samples_per_item", "num_inference_steps"):
            value = getattr(self, name)  # not every subclass can choose its steps: None
            if value is not None and value < 1:
                raise ValueError(f"{name} is {value}, but must be at least 1")
        for name in ("dropout", "context_dropout", "visual_dropout", "ema_decay"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must lie in [0, 1)")
        if self.width % self.heads:
            raise ValueError(f"width is {self.width}, which {self.heads} heads cannot share")
        if self.time_dim < 2 or self.time_dim % 2:
            raise ValueError(f"time_dim is {self.time_dim}, but must be even, for as many sines as cosines")

    @property
    def goal(self) -> str | None:
        """Observation key of the goal that the flow reads; None for a flow that knows of none."""
        return None

    @property
    def condition(self) -> tuple[str, int] | None:
        """Key and size of the vector that is a token of its own and dropped alone: the goal, if the flow reads one."""
        features = self.input_features or {}
        return (self.goal, math.prod(features[self.goal].shape)) if self.goal is not None else None

    @property
    def state_features(self) -> dict[str, int]:
        """Observation keys of the states that make up the context, and how many numbers each holds."""
        images = self.image_features
        return {
            key: math.prod(feature.shape)
            for key, feature in sorted((self.input_features or {}).items())
            if key not in images and key != self.goal
        }

    def validate_features(self) -> None:
        """Drop the excluded features and check that the rest suffices.

        Raises:
            ValueError: If the action, the goal or everything to be conditioned on is missing, or an image is no colour
                image; says what to exclude.
        """
        features = self.input_features or {}
        kept = {key: feature for key, feature in features.items() if key not in self.exclude_features}
        self.input_features: dict[str, PolicyFeature] = kept
        for key, feature in self.image_features.items():
            if feature.shape[0] != COLOURS:
                raise ValueError(
                    f"{self.type}: {key} has {feature.shape[0]} channels, but a colour image has {COLOURS}: leave it "
                    f"out by {excluding(key, *self.exclude_features)}"
                )
        if self.action_feature is None:
            raise ValueError(f"{self.type}: the data holds no 'action', only {_names(self.output_features)}")
        if self.goal is not None and self.goal not in self.input_features:
            raise ValueError(f"{self.type}: the data holds no {self.goal!r}, only {_names(self.input_features)}")
        if not self.state_features and not self.image_features:
            raise ValueError(
                f"{self.type}: nothing to be conditioned on; the data needs 'observation.state', "
                f"'observation.environment_state' or an image, but holds only {_names(features)}"
            )

    def get_optimizer_preset(self) -> AdamWConfig:
        return AdamWConfig(
            lr=self.optimizer_lr,
            betas=self.optimizer_betas,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        return None

    @property
    def observation_delta_indices(self) -> None:
        return None

    @property
    def action_delta_indices(self) -> list[int]:
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        return None


def _names(features: dict | None) -> str:
    return ", ".join(sorted(features or {})) or "nothing"
