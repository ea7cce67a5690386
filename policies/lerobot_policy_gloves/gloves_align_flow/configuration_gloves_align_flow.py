"""Settings of the align flow."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from lerobot.configs import PreTrainedConfig

from gloves_flow.configuration_flow import FlowConfig
from lerobot_gloves.recording.sources import SOURCES, source_of

LABEL = "source"
"""Key of the label in a batch: one-hot, (B, number of sources)."""


@PreTrainedConfig.register_subclass("gloves_align_flow")
@dataclass
class GlovesAlignFlowConfig(FlowConfig):
    """Expert flow v_e and agent flow v_u as two labels of one network.

    Trained on demonstrations and an agent's proposals merged into one dataset (`lerobot_gloves.recording.sources` says
    how an agent's is made). Conditioned on images and state, never on the goal, which only the agent knows.
    """

    # Whose flow v_u is: none (the agent as it is), noised, laggy, slow or shift. By default the only one that the
    # training data holds, or none.
    agent_source: str | None = None
    # Sources that training has met so far; training fills this in.
    sources: list[str] = field(default_factory=list)
    # Observations that the flow is not conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.agent_source is not None and self.agent_source not in SOURCES[1:]:
            raise ValueError(f"agent_source is {self.agent_source!r}: choose from {', '.join(SOURCES[1:])}")

    @property
    def condition(self) -> tuple[str, int]:
        return LABEL, len(SOURCES)

    @property
    def action_delta_indices(self) -> list[int]:
        """Far enough back that the whole proposal is there, whichever of its rows was drawn."""
        return list(range(1 - self.chunk_size, self.chunk_size))

    def check_tasks(self, tasks: Iterable[str]) -> None:
        """Refuse data without an agent, whose task strings these are.

        Raises:
            ValueError: If there is none and none was trained before, or its proposals are not of `chunk_size` actions.
        """
        agents = {length for source, length in map(source_of, tasks) if source != SOURCES[0]}
        if not agents and not self.sources:
            raise ValueError(
                "gloves_align_flow: the data holds the expert's chunks alone: record an agent's by gloves record "
                "--agent=<checkpoint>, and merge the two by lerobot-edit-dataset --operation.type=merge"
            )
        for length in agents - {self.chunk_size}:
            raise ValueError(
                f"gloves_align_flow: the data holds an agent's proposals of {length} actions, but chunk_size is "
                f"{self.chunk_size}"
            )

    def resolve_agent_source(self) -> str:
        """The source of v_u.

        Raises:
            ValueError: If it was not trained, or several were and none of them chosen.
        """
        agents = [source for source in self.sources if source != SOURCES[0]]
        chosen = self.agent_source or (agents[0] if len(agents) == 1 else SOURCES[1])
        if chosen not in agents:
            raise ValueError(
                f"agent_source is {chosen!r}, which the align flow was not trained on: choose from "
                f"{', '.join(agents) or 'nothing, it has seen no agent'}"
            )
        return chosen
