"""The expert flow as an adapter."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.editors import FEEG, FPAS
from lerobot_gloves.generators import Generators
from lerobot_gloves.networks import BoundVelocity
from lerobot_gloves.scores import SCORES

from ..flow.modeling_flow import FlowPolicy
from .configuration_gloves_expert_flow import GlovesExpertFlowConfig


class GlovesExpertFlowPolicy(FlowPolicy):
    """The expert flow v_e (paper, "Methods").

    As an adapter it scores proposals, and edits them by FPAS or FEEG; as a policy by itself it acts like the expert,
    without a goal.
    """

    config_class = GlovesExpertFlowConfig
    name = "gloves_expert_flow"
    editors: Mapping[str, type] = {"fpas": FPAS, "feeg": FEEG}
    scores: Mapping[str, type] = SCORES

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor]) -> "BoundExpertFlow":
        """See `lerobot_gloves.adapter.Adapter`."""
        self.eval()
        # Outside inference mode, so that FEEG may differentiate through what is made here.
        with torch.inference_mode(False):
            batch = {key: observation[key].clone() for key in self.config.input_features}
            return BoundExpertFlow(self.velocity(batch))


class BoundExpertFlow:
    """The expert flow of B contexts (see `lerobot_gloves.adapter.BoundAdapter`)."""

    def __init__(self, velocity: BoundVelocity):
        self.velocity = velocity

    @property
    def evaluations(self) -> int:
        return self.velocity.evaluations

    def select(self, rows: Tensor) -> "BoundExpertFlow":
        return BoundExpertFlow(self.velocity.select(rows))

    @torch.no_grad()
    def score(self, chunk: Tensor, score: Any, length: int | None = None) -> Tensor:
        return score(self.velocity, chunk, length=length)

    def edit(
        self,
        proposal: Tensor,
        editor: Any,
        *,
        score: Any,
        threshold: float | None,
        length: int | None = None,
        generator: Generators = None,
    ) -> Tensor:
        if not isinstance(editor, FPAS):
            return editor(proposal, self.velocity, generator=generator)
        if threshold is None:
            raise ValueError("fpas searches below the gate's threshold: calibrate the adapter (gloves calibrate)")

        windowed = partial(score, length=length)
        return editor(proposal, self.velocity, score=windowed, threshold=threshold, generator=generator)
