"""Settings of the expert flow."""

from dataclasses import dataclass, field

from lerobot.configs import PreTrainedConfig

from gloves_flow.configuration_flow import FlowConfig


@PreTrainedConfig.register_subclass("gloves_expert_flow")
@dataclass
class GlovesExpertFlowConfig(FlowConfig):
    """The expert flow v_e: conditioned on images and state, never on the goal, which only the agent knows."""

    # For IFAE: folder or Hub id of a gloves_align_flow trained on the agent's proposals, with the same normalisation.
    agent_flow: str | None = None
    # For IFAE: whose flow of agent_flow v_u is, as its own option of that name.
    agent_source: str | None = None
    # Observations that the flow is not conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])
