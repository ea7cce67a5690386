"""The expert flow as an adapter."""

from collections.abc import Mapping

import torch
from torch import Tensor

from gloves_flow.bound_flow import BoundFlow
from gloves_flow.modeling_flow import FlowPolicy
from lerobot_gloves.editors import EDITORS
from lerobot_gloves.scores import SCORES

from .agent_flow import load_agent_flow
from .configuration_gloves_expert_flow import GlovesExpertFlowConfig


class GlovesExpertFlowPolicy(FlowPolicy):
    """The expert flow v_e (paper, "Methods").

    As an adapter it scores proposals, and edits them by FEEG or FPAS, or, given an agent flow from another checkpoint,
    by IFAE; as a policy by itself it acts like the expert, without a goal.
    """

    config_class = GlovesExpertFlowConfig
    name = "gloves_expert_flow"
    about = (
        "An expert flow: it tells how unlike an expert's a chunk of actions is, and edits it towards the expert's "
        "(FEEG, FPAS)."
    )
    editors: Mapping[str, type] = EDITORS
    default_editor = "feeg"
    scores: Mapping[str, type] = SCORES

    def __init__(self, config: GlovesExpertFlowConfig, **kwargs: object):
        super().__init__(config, **kwargs)
        # Of a function, so that the other checkpoint's weights are not saved, hashed or calibrated as these ones.
        wanted = config.agent_flow is not None and config.pretrained_path is not None
        self._agent_velocity = load_agent_flow(config) if wanted else None

    @property
    def has_agent(self) -> bool:
        """See `lerobot_gloves.adapter.Adapter`."""
        return self._agent_velocity is not None

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor]) -> BoundFlow:
        """See `lerobot_gloves.adapter.Adapter`."""
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        # Outside inference mode, so that FEEG may differentiate through what is made here.
        with torch.inference_mode(False):
            batch = {key: observation[key].clone() for key in self.config.input_features}
            agent = self._agent_velocity
            return BoundFlow(self.velocity(batch), None if agent is None else lambda: agent(batch))
