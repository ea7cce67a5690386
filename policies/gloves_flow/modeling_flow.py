"""Training and sampling shared by the policies that are flows.

The baselines, which are diffusion and consistency models of the same network, bring a loss and a sampler of their own.
"""

import logging
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

import torch
from huggingface_hub import ModelCard
from lerobot.configs import PreTrainedConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.checkpoints.card import policy_card
from lerobot_gloves.checkpoints.recommendation import Recommendation
from lerobot_gloves.flow import flow_matching_loss, integrate
from lerobot_gloves.generators import Episodes, randn, spawn
from lerobot_gloves.networks import BoundVelocity, VelocityNetwork

from . import backbones
from .configuration_flow import FlowConfig

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

RAW, AVERAGED = "network.", "ema.module."
PEFT_TARGETS = ("qkv", "query", "kv", "out", "mlp.0", "mlp.2")
"""Ends of the names of the layers that PEFT adapts by default: attention and MLPs of the DiT."""

type Tensors = tuple[Tensor, ...] | list[Tensor]


class FlowPolicy(PreTrainedPolicy):
    """A conditional flow over action chunks, trained by flow matching and sampled by Euler integration.

    Two copies of the network live side by side: the one that is trained and its exponential moving average, which
    evaluation uses. A checkpoint that holds the average alone is complete for inference.

    Attributes:
        calibration: The calibration of the checkpoint that these weights are from, None if it has none. Saving and
            pushing the policy carries it along, as long as it belongs to the weights.
        recommendation: What `gloves tune` chose for them, likewise.
    """

    config_class = FlowConfig
    name = "flow"
    about = "A flow over chunks of actions."
    """What it is for, in a sentence or two of its model card."""

    def __init__(self, config: FlowConfig, dataset_meta: "LeRobotDatasetMetadata | None" = None, **_: object):
        super().__init__(config)
        config.validate_features()
        if dataset_meta is not None:
            config.fps = dataset_meta.fps
            from .batches import install  # a training has imported LeRobot's datasets; nothing else needs to

            install()
        backbones.fill_in_normalisation(config)
        self.network = self.make_network(
            config,
            width=config.width,
            depth=config.depth,
            heads=config.heads,
            mlp_ratio=config.mlp_ratio,
            dropout=config.dropout,
            time_dim=config.time_dim,
        )
        if not config.pretrained_path:
            backbones.start(self.network, config)
        self.ema = AveragedModel(self.network, multi_avg_fn=self._average)
        self.ema.requires_grad_(False)
        self.calibration: Calibration | None = None
        self.recommendation: Recommendation | None = None
        self._episodes = Episodes()
        self.reset()

    def make_network(self, config: Any, **dit: int | float) -> VelocityNetwork:
        """The network of a configuration, as it is before training; `dit` are the arguments of `DiT`."""
        return VelocityNetwork(
            config.action_feature.shape[0],
            states=config.state_features,
            cameras=sorted(config.image_features),
            goal=config.condition,
            context_dim=config.context_dim,
            context_dropout=config.context_dropout,
            visual_dropout=config.visual_dropout,
            backbone_norm=config.backbone_norm,
            backbone_dtype=config.backbone_dtype,
            **dit,
        )

    @property
    def averaged(self) -> VelocityNetwork:
        """The network with the averaged weights, which inference uses."""
        return cast(VelocityNetwork, self.ema.module)

    @classmethod
    def from_pretrained(
        cls, pretrained_name_or_path: str | Path, *, config: PreTrainedConfig | None = None, **kwargs: Any
    ) -> Self:
        # The checkpoint brings all weights: knowing where from keeps the image encoders from fetching ImageNet's.
        if config is None:
            config = PreTrainedConfig.from_pretrained(pretrained_name_or_path, revision=kwargs.get("revision"))
        if not config.pretrained_path:
            config.pretrained_path = pretrained_name_or_path
        policy = super().from_pretrained(pretrained_name_or_path, config=config, **kwargs)
        if config.use_peft:  # these are the weights that PEFT started from
            policy.network.load_state_dict(policy.averaged.state_dict())
        else:
            policy.calibration = Calibration.load(pretrained_name_or_path, kwargs.get("revision"))
            policy.recommendation = Recommendation.load(pretrained_name_or_path, kwargs.get("revision"))
        return policy

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        super()._save_pretrained(save_directory, state_dict=state_dict)
        if self.calibration is None and self.recommendation is None:
            return
        weights = weights_hash(self.state_dict() if state_dict is None else state_dict)
        for name, command in (("calibration", "calibrate"), ("recommendation", "tune")):
            kept = getattr(self, name)
            if kept is not None and kept.weights != weights:
                logging.warning(
                    "the weights have changed, so their %s is not saved: run gloves %s again", name, command
                )
                setattr(self, name, None)
            elif kept is not None:
                kept.save(save_directory)

    def generate_model_card(self, *_: Any, cfg: TrainPipelineConfig | None = None, **__: Any) -> ModelCard:
        """The card that LeRobot pushes beside the weights; LeRobot's own tells how to run a policy by itself."""
        training = {} if cfg is None else cfg.to_dict()
        return policy_card(
            type(self), self.config, training, self.calibration, self.config.repo_id, recommended=self.recommendation
        )

    @staticmethod
    def facts(config: Any) -> Mapping[str, str]:
        """What its model card says besides: text by what it is."""
        return {}

    @classmethod
    def _load_as_safetensor(cls, model: "FlowPolicy", model_file: str, map_location: str, strict: bool) -> "FlowPolicy":
        try:
            with safe_open(model_file, framework="pt") as file:
                found = set(file.keys())
        except (SafetensorError, OSError) as error:
            raise ValueError(f"{Path(model_file)} is not a readable safetensors file: {error}") from error
        expected, averaged_only = set(model.state_dict()), not any(key.startswith(RAW) for key in found)
        if averaged_only:
            expected = {key for key in expected if not key.startswith(RAW)}
        if found != expected:
            raise ValueError(
                f"{Path(model_file)} does not hold the weights of this {cls.name}: {len(expected - found)} are missing "
                f"and {len(found - expected)} are foreign, such as {min(found ^ expected)!r}"
            )
        try:
            # Not LeRobot's loader, which would warn of the raw weights that a checkpoint may do without.
            model.load_state_dict(load_file(model_file, device=map_location), strict=False)
        except RuntimeError as error:
            mismatch = str(error).strip().splitlines()[-1].strip()
            raise ValueError(f"{Path(model_file)} holds weights of another size: {mismatch}") from error
        if averaged_only:
            model.network.load_state_dict(model.averaged.state_dict())
        return model

    def wrap_with_peft(self, peft_config: Any = None, peft_cli_overrides: dict | None = None) -> PreTrainedPolicy:
        """Called by `lerobot-train --peft.method_type=...`: fine-tune the averaged weights, which inference uses.

        PEFT's layers stand in both networks and are averaged like any other weight. PEFT saves its layers alone, so the
        two must have the frozen weights in common.

        Raises:
            ValueError: If `--peft.target_modules` names layers of one of the two networks alone.
        """
        self.network.load_state_dict(self.averaged.state_dict())
        wrapped: Any = super().wrap_with_peft(peft_config, peft_cli_overrides)
        ours, theirs = self.network.state_dict(), self.averaged.state_dict()
        if ours.keys() != theirs.keys():
            raise ValueError(
                "--peft.target_modules must name the layers of the network and of its average alike, by the end of "
                f"their names, such as qkv, but {min(ours.keys() ^ theirs.keys())} is in one alone"
            )
        self.averaged.load_state_dict(ours)  # PEFT draws each layer's first weights by itself
        self.ema.requires_grad_(False)
        self.ema.n_averaged.zero_()
        for config in wrapped.peft_config.values():
            start = config.base_model_name_or_path
            if start is not None and Path(start).is_dir():
                config.base_model_name_or_path = str(Path(start).resolve())  # wherever it will be used from
        return wrapped

    def _get_default_peft_targets(self) -> dict[str, Any]:
        return {"target_modules": list(PEFT_TARGETS)}

    def get_optim_params(self) -> list[dict]:
        """Pretrained backbones of the image encoders learn at a rate of their own, or not at all."""
        backbone = [parameter for e in self.network.image_encoders for parameter in e.backbone.parameters()]
        if not backbone or self.config.pretrained_backbone_weights is None:
            return [{"params": list(self.network.parameters())}]
        slow, rate = {id(parameter) for parameter in backbone}, self.config.optimizer_lr_backbone
        rest = {"params": [parameter for parameter in self.network.parameters() if id(parameter) not in slow]}
        if rate == 0:
            for parameter in backbone:
                parameter.requires_grad_(False)
            return [rest]
        return [rest, {"params": backbone, "lr": rate}]

    def update(self) -> None:
        """Called by `lerobot-train` after every optimiser step."""
        self.ema.update_parameters(self.network)

    @torch.no_grad()
    def _average(self, averaged: Tensors, current: Tensors, updates: Tensor | int) -> None:
        warm_up = (1 + int(updates)) / (10 + int(updates))
        torch._foreach_lerp_(averaged, current, 1 - min(self.config.ema_decay, warm_up))

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Flow-matching loss of the trained weights, or in eval mode of the averaged ones.

        Args:
            batch: Normalised observations, `action` (B, T, A) and, if padded, `action_is_pad` (B, T).
            reduction: "mean", or "none" for one loss per item.
        """
        mask = ~batch["action_is_pad"] if "action_is_pad" in batch else None
        network = self.network if self.training else self.averaged
        loss = self.loss(network.bind(batch), batch["action"], mask)
        return (loss.mean() if reduction == "mean" else loss), {}

    def loss(self, network: BoundVelocity, action: Tensor, mask: Tensor | None) -> Tensor:
        """Training loss (B,) of normalised chunks (B, T, A), whose valid actions `mask` (B, T) marks."""
        return flow_matching_loss(network, action, mask=mask, samples=self.config.samples_per_item)

    def sample(self, network: BoundVelocity, noise: Tensor) -> Tensor:
        """Normalised chunks (B, T, A) from noise of that shape."""
        return integrate(network, noise, steps=self.config.num_inference_steps)

    def velocity(self, batch: Mapping[str, Tensor]) -> BoundVelocity:
        """The averaged network's velocity field, bound to the contexts of normalised observations."""
        return self.averaged.bind(batch, guidance=self.config.guidance)

    def reset(self) -> None:
        """A new episode begins in every environment."""
        self._episodes.reset()
        self._action_queue: deque[Tensor] = deque(maxlen=self.config.n_action_steps)

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], **_: object) -> Tensor:
        """Sample normalised chunks (B, T, A) for B normalised observations."""
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        velocity = self.velocity(batch)
        batch_size = next(batch[key] for key in self.config.input_features if key in batch).shape[0]
        if self._episodes.begin(batch_size):
            self._generators = spawn(self.config.seed, batch_size, first_episode=self._episodes.first, stream=self.name)
        shape = (batch_size, self.config.chunk_size, self.config.action_feature.shape[0])
        # Like a parameter, not like an activation: under autocast that would have half the precision.
        noise = randn(shape, self._generators, like=next(self.averaged.parameters()))
        return self.sample(velocity, noise)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], **_: object) -> Tensor:
        """The next normalised action (B, A); samples a chunk when the last one is used up."""
        if not self._action_queue:
            chunk = self.predict_action_chunk(batch)
            self._action_queue.extend(chunk[:, : self.config.n_action_steps].transpose(0, 1))
        return self._action_queue.popleft()
