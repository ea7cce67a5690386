"""The align flow as a policy and as an adapter."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor

from gloves_flow.bound_flow import BoundFlow
from gloves_flow.modeling_flow import FlowPolicy
from lerobot_gloves.editors import EDITORS
from lerobot_gloves.networks import BoundVelocity
from lerobot_gloves.recording.sources import SOURCES, source_of
from lerobot_gloves.scores import SCORES

from .configuration_gloves_align_flow import LABEL, GlovesAlignFlowConfig
from .split import check_split

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata


class GlovesAlignFlowPolicy(FlowPolicy):
    """Expert flow v_e and agent flow v_u in one network, so that what it errs in cancels in their difference.

    As an adapter it scores proposals by v_e, and edits them by IFAE, FEEG or FPAS; as a policy by itself it acts like
    the expert, without a goal.

    Args:
        config: Its settings.
        dataset_meta: The dataset that it is trained on; LeRobot's factory passes it.
        **kwargs: What else LeRobot's factory passes.
    """

    config_class = GlovesAlignFlowConfig
    name = "gloves_align_flow"
    about = (
        "An align flow: an expert's chunks of actions and an agent's in one network, along whose difference IFAE edits "
        "what that agent proposes."
    )
    editors: Mapping[str, type] = EDITORS
    default_editor = "ifae"
    scores: Mapping[str, type] = SCORES
    has_agent = True

    def __init__(
        self, config: GlovesAlignFlowConfig, dataset_meta: "LeRobotDatasetMetadata | None" = None, **kwargs: object
    ):
        if dataset_meta is not None:
            config.check_tasks(dataset_meta.tasks.index)
            check_split(config, dataset_meta)
        super().__init__(config, dataset_meta=dataset_meta, **kwargs)

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Flow-matching loss, see `FlowPolicy.forward`.

        Args:
            batch: Normalised observations; `action` (B, 2 T - 1, A) from T - 1 rows before the drawn one to T - 1 after
                it and `action_is_pad` (B, 2 T - 1); the row's `timestamp` (B,) and `task`, B strings.
            reduction: "mean", or "none" for one loss per item.
        """
        return super().forward(self._chunks(batch), reduction)

    def _chunks(self, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        """The batch with the chunk of T actions that each row belongs to, and the label of who made it."""
        if self.config.fps is None:
            raise ValueError("gloves_align_flow needs the dataset's frame rate to train: make it by lerobot-train")
        action, device = batch["action"], batch["action"].device
        sources, lengths = zip(*map(source_of, batch["task"]), strict=True)
        if self.training:  # Not from the dataset's list of tasks: --dataset.episodes may have left some out.
            self.config.sources = [source for source in SOURCES if source in {*self.config.sources, *sources}]
        # Of single precision, as not every device has double: exact below four million rows an episode.
        rows = (batch["timestamp"].float() * self.config.fps).round().long()
        # An agent's rows come in blocks of one proposal; the expert's each begin a chunk, a block of one row.
        begin = self.config.chunk_size - 1 - rows % torch.tensor(lengths, device=device)
        window = begin[:, None] + torch.arange(self.config.chunk_size, device=device)
        return {
            **batch,
            "action": action.gather(1, window[..., None].expand(-1, -1, action.shape[-1])),
            "action_is_pad": batch["action_is_pad"].gather(1, window),
            LABEL: self._label(torch.tensor([SOURCES.index(source) for source in sources], device=device), action),
        }

    def velocity(self, batch: Mapping[str, Tensor], source: str = SOURCES[0]) -> BoundVelocity:
        """The averaged network's field for a source, bound to the contexts of normalised observations."""
        return self._bind(batch, self.averaged.encode(batch), source)

    def agent_velocity(self, batch: Mapping[str, Tensor]) -> BoundVelocity:
        """v_u, bound to the contexts of normalised observations.

        Raises:
            ValueError: If the chosen source was not trained.
        """
        return self.velocity(batch, self.config.resolve_agent_source())

    def _bind(self, batch: Mapping[str, Tensor], tokens: Tensor, source: str) -> BoundVelocity:
        index = torch.full(tokens.shape[:1], SOURCES.index(source), device=tokens.device)
        labelled = {**batch, LABEL: self._label(index, tokens)}
        return self.averaged.bind(labelled, guidance=self.config.guidance, tokens=tokens)

    @staticmethod
    def _label(index: Tensor, like: Tensor) -> Tensor:
        """One-hot labels (B, number of sources) of indices (B,)."""
        return F.one_hot(index, len(SOURCES)).to(like.dtype)

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor]) -> BoundFlow:
        """See `lerobot_gloves.adapter.Adapter`.

        Raises:
            ValueError: If no expert was among the training data.
        """
        if SOURCES[0] not in self.config.sources:
            raise ValueError(
                "this gloves_align_flow has seen no expert, only "
                f"{', '.join(self.config.sources) or 'nothing'}: train it on expert and agent data merged"
            )
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        # Outside inference mode, so that FEEG may differentiate through what is made here.
        with torch.inference_mode(False):
            batch = {key: observation[key].clone() for key in self.config.input_features}
            tokens = self.averaged.encode(batch)
            source = self.config.resolve_agent_source
            return BoundFlow(self._bind(batch, tokens, SOURCES[0]), lambda: self._bind(batch, tokens, source()))
