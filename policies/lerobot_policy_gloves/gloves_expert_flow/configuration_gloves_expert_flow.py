"""Settings of the expert flow."""

from dataclasses import dataclass, field

from lerobot.configs import PreTrainedConfig

from ..flow.configuration_flow import FlowConfig


@PreTrainedConfig.register_subclass("gloves_expert_flow")
@dataclass
class GlovesExpertFlowConfig(FlowConfig):
    """The expert flow v_e: conditioned on images and state, never on the goal, which only the agent knows."""

    # Observations that the flow is not conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])
