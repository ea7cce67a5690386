"""Settings of the flow policy."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from gloves_flow.configuration_flow import FlowConfig


@PreTrainedConfig.register_subclass("gloves_flow_policy")
@dataclass
class GlovesFlowConfig(FlowConfig):
    """The expert flow's network with the goal as one more token."""

    goal_feature: str = "observation.goal"  # Observation key of the goal.

    @property
    def goal(self) -> str:
        return self.goal_feature
