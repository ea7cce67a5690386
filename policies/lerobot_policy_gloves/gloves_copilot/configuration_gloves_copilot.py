"""Settings of the copilot."""

from dataclasses import dataclass, field

from lerobot.configs import PreTrainedConfig
from lerobot.optim.schedulers import CosineDecayWithWarmupSchedulerConfig

from gloves_flow.configuration_flow import FlowConfig
from lerobot_gloves.faults import RandomisedAgents


@PreTrainedConfig.register_subclass("gloves_copilot")
@dataclass
class GlovesCopilotConfig(FlowConfig):
    """p(expert's chunk | context, proposal, last proposals), from demonstrations and randomised faults alone."""

    # How many of the agent's last proposals are read besides the one to be corrected.
    history: int = 4
    # Actions between two decisions of the agent in training; null for n_action_steps.
    decision_every: int | None = None
    # Of the histories that go back beyond the episode's first decision, the share that goes on in another episode: a
    # demonstration may be a part of what the agent does, and what it did before that is then nothing to go by.
    strangers: float = 0.5
    # Where the observations turn out to be known by heart (see `Witnesses`), or there are too few demonstrations to
    # tell: share of the draws that are told proposals and see another item's context. Whoever trusts what is observed
    # without reserve believes the demonstrations then rather than what is proposed.
    context_swap: float = 0.5
    # What the randomised agents of training suffer from, names of lerobot_gloves.faults.FAULTS.
    faults: list[str] = field(default_factory=lambda: ["scale", "offset", "noise", "drift", "delay", "replay"])
    # Share of those agents that have no fault.
    healthy: float = 0.2
    # Of the others, the share that has two.
    several: float = 0.25
    # Share of the training's draws that are of the mean, at t = 0 from no noise, rather than of the flow.
    mean_share: float = 0.6
    # Share of the draws that are told no proposal: there the flow is the expert's.
    alone_share: float = 0.2
    # The editor where nobody names a method: copilot, or feeg for whoever is to be moved as little as it takes.
    method: str = "copilot"
    # The score of a gate where nobody names one.
    gate_score: str = "correction"
    # Its level where nobody names one.
    gate_alpha: float = 0.05
    # Observations that the copilot is not conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.history < 0:
            raise ValueError(f"history is {self.history}, but must not be negative")
        if self.decision_every is not None and not 1 <= self.decision_every <= self.chunk_size:
            raise ValueError(f"decision_every is {self.decision_every}, but must lie between 1 and {self.chunk_size}")
        for name in ("strangers", "context_swap", "gate_alpha"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}, but must lie in [0, 1]")
        if min(self.mean_share, self.alone_share) < 0 or self.mean_share + self.alone_share > 1:
            raise ValueError(
                f"mean_share and alone_share are {self.mean_share} and {self.alone_share}, but must share one whole"
            )
        _ = self.agents  # refuses faults that there are not

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        # LeRobot scales both to the length of the training.
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=10_000, num_decay_steps=1_000_000, peak_lr=self.optimizer_lr, decay_lr=0.0
        )

    @property
    def agents(self) -> RandomisedAgents:
        """Who proposes in training."""
        return RandomisedAgents(tuple(self.faults), self.healthy, self.several)

    @property
    def stride(self) -> int:
        """Actions between two decisions of the agent in training."""
        return self.decision_every or self.n_action_steps

    @property
    def action_delta_indices(self) -> list[int]:
        """Back to where the oldest proposal that is read begins."""
        return list(range(-self.history * self.stride, self.chunk_size))
