"""The copilot as a policy and as an adapter."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from gloves_flow.modeling_flow import FlowPolicy
from lerobot_gloves.editors import EDITORS, Copilot
from lerobot_gloves.faults import CONSTANT, Units
from lerobot_gloves.flow import interpolate, mean_per_chunk
from lerobot_gloves.generators import rand, randn
from lerobot_gloves.networks.copilot import CopilotNetwork, repeats, told
from lerobot_gloves.scores import SCORES, CorrectionScore
from lerobot_gloves.specification import parse

from .bound_copilot import BoundCopilot
from .configuration_gloves_copilot import GlovesCopilotConfig
from .witnesses import Witnesses

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata


class GlovesCopilotPolicy(FlowPolicy):
    """p(expert's chunk | context, proposal, the last proposals), from demonstrations and randomised faults alone.

    Training never sees an agent: the expert's chunks of the last decisions, made faulty by an agent that is drawn anew
    for every item (`lerobot_gloves.faults`), stand for what one proposes, and the expert's own chunk is what it should
    have proposed. One network is both the posterior's flow and, at t = 0 from no noise, its mean. Whether it may
    believe what it observes, `witnesses` find out on the way.

    Args:
        config: Its settings.
        dataset_meta: The dataset that it is trained on; LeRobot's factory passes it.
        **kwargs: What else LeRobot's factory passes.
    """

    config_class = GlovesCopilotConfig
    name = "gloves_copilot"
    about = (
        "A copilot: it reads what an agent proposes and proposed before, and corrects what is wrong with it. It was "
        "trained on an expert's demonstrations alone, made faulty at random, and needs no setting."
    )
    editors: Mapping[str, type] = {"copilot": Copilot, **EDITORS}
    default_editor = "copilot"
    scores: Mapping[str, type] = {**SCORES, "correction": CorrectionScore}
    gate_score = "correction"

    def __init__(
        self, config: GlovesCopilotConfig, dataset_meta: "LeRobotDatasetMetadata | None" = None, **kwargs: object
    ):
        super().__init__(config, dataset_meta=dataset_meta, **kwargs)
        parse(config.method, self.editors, "method")  # refuses what it cannot do
        parse(config.gate_score, self.scores, "gate_score")
        self.default_editor, self.gate_score = config.method, config.gate_score
        self.gate_alpha = config.gate_alpha
        zero, spread = torch.zeros(config.action_feature.shape[0]), torch.ones(config.action_feature.shape[0])
        if dataset_meta is not None:
            known = {name: torch.as_tensor(value) for name, value in dataset_meta.stats["action"].items()}
            # A constant's deviation may be its rounding.
            deviation = torch.where(known["max"] > known["min"], known["std"], 0.0)
            spread = deviation.float().clamp(CONSTANT)
            zero = torch.where(spread > CONSTANT, -known["mean"].float() / spread, 0.0)
        self.witnesses = Witnesses(
            *((0, 0) if dataset_meta is None else (dataset_meta.total_episodes, dataset_meta.total_frames))
        )
        self.register_buffer("zero", zero)
        self.register_buffer("spread", spread)

    @staticmethod
    def facts(config: GlovesCopilotConfig) -> Mapping[str, str]:
        """The faults that its training drew, how many proposals it reads, and what it does when it doubts."""
        return {
            "faults of its training": f"{', '.join(config.faults)}; none in {100 * config.healthy:g} % of the draws, "
            f"two in {100 * config.several:g} % of the others",
            "reads": f"the proposal and the last {config.history}, {config.stride} actions apart",
            "doubt": f"another item's observations in {100 * config.context_swap:g} % of the draws, once its own are "
            "known by heart",
        }

    @property
    def history(self) -> int:
        """How many of the agent's last proposals it wants to be told (see `lerobot_gloves.adapter.Adapter`)."""
        return self.config.history

    @property
    def stride(self) -> int:
        """Actions between two decisions in training (see `lerobot_gloves.adapter.Adapter`)."""
        return self.config.stride

    def make_network(self, config: GlovesCopilotConfig, **dit: int | float) -> CopilotNetwork:
        return CopilotNetwork(
            config.action_feature.shape[0],
            proposals=config.history + 1,
            context_dim=config.context_dim,
            states=config.state_features,
            cameras=sorted(config.image_features),
            context_dropout=config.context_dropout,
            visual_dropout=config.visual_dropout,
            backbone_norm=config.backbone_norm,
            backbone_dtype=config.backbone_dtype,
            **dit,
        )

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Loss, see `FlowPolicy.forward`.

        Args:
            batch: Normalised observations; `action` (B, K s + T, A) from the oldest decision that is read, s actions
                apart, to the end of the chunk that begins now, and `action_is_pad` (B, K s + T).
            reduction: "mean", or "none" for one loss per item.
        """
        config, samples = self.config, self.config.samples_per_item
        pad = batch.get("action_is_pad", torch.zeros_like(batch["action"][..., 0], dtype=torch.bool))
        chunks, there = (part.repeat_interleave(samples, dim=0) for part in self.decisions(batch["action"], pad))
        chunks, there = self.among_strangers(chunks, there)
        proposals, action = config.agents(chunks, Units(self.zero, self.spread)), chunks[:, -1]
        kind = rand(action.shape[:1], None, like=action)
        alone, of_mean = kind < config.alone_share, kind >= 1 - config.mean_share
        network = self.network if self.training else self.averaged
        tokens = network.encode(batch).repeat_interleave(samples, dim=0)
        if self.witnesses.doubted:
            swapped = ~alone & ~repeats(proposals, there)[:, -1]
            swapped &= rand(action.shape[:1], None, like=action) < config.context_swap
            other = torch.randint(len(tokens), (len(tokens),), device=tokens.device)
            tokens = torch.where(swapped[:, None, None], tokens[other], tokens)
        bound = told(network.bind(batch, tokens=tokens), proposals, there & ~alone[:, None])
        noise, t = randn(action.shape, None, like=action), rand(action.shape[:1], None, like=action)
        noise, t = torch.where(of_mean[:, None, None], 0.0, noise), torch.where(of_mean, 0.0, t)
        error = bound(interpolate(noise, action, t), t) - (action - noise)
        mask = ~pad[:, -config.chunk_size :]
        loss = mean_per_chunk(error.square(), samples, mask)
        if self.training and self.witnesses.asked and "episode_index" in batch:
            theirs = self.witnesses.among(batch["episode_index"])
            asked, valid = of_mean & ~alone, mask.repeat_interleave(samples, dim=0).to(error.dtype)
            distance = (error.detach().norm(dim=2) * valid).sum(dim=1) / valid.sum(dim=1).clamp(min=1)
            self.witnesses.hear(distance[asked], theirs.repeat_interleave(samples)[asked], len(theirs))
            # The mean of the loss is that of the items that are learned from.
            loss = torch.where(theirs, 0.0, loss) * len(theirs) / (~theirs).sum().clamp(min=1)
        return (loss.mean() if reduction == "mean" else loss), {}

    def decisions(self, action: Tensor, pad: Tensor) -> tuple[Tensor, Tensor]:
        """The expert's chunks (B, K + 1, T, A) at the last decisions, and which of these there were, bool (B, K + 1).

        What lies before the episode's first decision is that decision's chunk: whoever repeats it repeats that.
        """
        length, stride, count = self.config.chunk_size, self.config.stride, self.config.history + 1
        begins = [decision * stride for decision in range(count)]
        chunks = torch.stack([action[:, begin : begin + length] for begin in begins], dim=1)
        there = ~pad[:, begins]
        there[:, -1] = True
        first = there.int().argmax(dim=1)
        source = torch.maximum(torch.arange(count, device=action.device)[None], first[:, None])
        return chunks.gather(1, source[..., None, None].expand_as(chunks)), there

    def among_strangers(self, chunks: Tensor, there: Tensor) -> tuple[Tensor, Tensor]:
        """The same, where some of what lies before an episode is made of other items of the batch, and is there."""
        rows = len(chunks)
        mixed = rand((rows, 1), None, like=chunks) < self.config.strangers
        other = chunks[torch.randint(rows, (rows,), device=chunks.device)]
        return torch.where((mixed & ~there)[..., None, None], other, chunks), there | mixed

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor], history: Tensor | None = None) -> BoundCopilot:
        """See `lerobot_gloves.adapter.Adapter`."""
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        # Outside inference mode, so that FEEG may differentiate through what is made here.
        with torch.inference_mode(False):
            batch = {key: observation[key].clone() for key in self.config.input_features}
            return BoundCopilot(self.velocity(batch), history, self.config.history + 1)
