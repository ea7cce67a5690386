"""The goal-conditioned imitation agent (paper, appendix "Imitation Learning Policy with wrapper")."""

from gloves_flow.modeling_flow import FlowPolicy

from .configuration_gloves_flow_policy import GlovesFlowConfig


class GlovesFlowPolicy(FlowPolicy):
    """A flow over the expert's chunks that is told the goal."""

    config_class = GlovesFlowConfig
    name = "gloves_flow_policy"
    about = "An agent: a flow over chunks of actions that is told the goal."
