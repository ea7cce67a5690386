"""Settings of the baseline `ddpm_assist`.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import PreTrainedConfig

from gloves_flow.configuration_flow import FlowConfig

SCHEDULES = ("sigmoid", "linear", "squaredcos_cap_v2")
"""Noise schedules, by their names in diffusers. The first is the original's."""


@PreTrainedConfig.register_subclass("ddpm_assist")
@dataclass
class DdpmAssistConfig(FlowConfig):
    """A denoising diffusion model (DDPM) of the expert's chunks, conditioned as the expert flow is.

    The original models states and actions together and overwrites the states after every step; here the network is
    conditioned on them, which is what makes images possible. Its step sizes, schedule and variances are the original's.
    """

    # Diffusion steps, N.
    num_train_steps: int = 50
    # Noise schedule: sigmoid (the original's), linear or squaredcos_cap_v2.
    schedule: str = "sigmoid"
    # Smallest beta of the sigmoid and linear schedules; squaredcos_cap_v2 has none to choose.
    beta_min: float = 1e-4
    # Largest beta of the sigmoid and linear schedules.
    beta_max: float = 0.26

    # Leave it out: ancestral sampling takes all num_train_steps.
    num_inference_steps: Any = None
    # Observations that the model is not conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.schedule not in SCHEDULES:
            raise ValueError(f"ddpm_assist has no schedule {self.schedule!r}: choose from {', '.join(SCHEDULES)}")
        if self.num_train_steps < 2:
            raise ValueError(f"ddpm_assist: num_train_steps is {self.num_train_steps}, but must be at least 2")
        if not 0 < self.beta_min <= self.beta_max < 1:
            raise ValueError(
                f"ddpm_assist: beta_min is {self.beta_min} and beta_max is {self.beta_max}, but 0 < beta_min <= "
                "beta_max < 1 must hold"
            )
        # Typed as Any, since a flow's is a number and here none is left to choose.
        if self.num_inference_steps is not None:
            raise ValueError(
                f"ddpm_assist: num_inference_steps is {self.num_inference_steps}, but sampling takes all "
                f"num_train_steps, {self.num_train_steps}: leave it out"
            )
