"""The baseline `ddpm_assist`: a diffusion model of the expert's chunks, and the same as an adapter."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from gloves_flow.modeling_flow import FlowPolicy
from lerobot_gloves.editors import Reference
from lerobot_gloves.networks import BoundVelocity

from .configuration_ddpm_assist import DdpmAssistConfig
from .diffusion import Diffusion, noise_prediction_loss, noise_scheduler
from .editor import DDPM

if TYPE_CHECKING:
    from diffusers.schedulers.scheduling_ddpm import DDPMScheduler


class DdpmAssistPolicy(FlowPolicy):
    """Shared autonomy by diffusion (Yoneda et al., "To the Noise and Back", RSS 2023) on action chunks.

    The flow's network, predicting noise in the place of a velocity. As an adapter it edits proposals by DDPM; it scores
    none. As a policy by itself it acts like the expert, without a goal.

    Raises:
        ImportError: If diffusers is not installed.
    """

    config_class = DdpmAssistConfig
    name = "ddpm_assist"
    about = (
        "A diffusion model of an expert's actions that assists by noising a proposal and denoising it (\"To the Noise "
        'and Back").'
    )
    editors: Mapping[str, type] = {"ddpm": DDPM}
    default_editor = "ddpm"
    scores: Mapping[str, type] = {}

    def __init__(self, config: DdpmAssistConfig, **kwargs: object):
        scheduler = noise_scheduler(config.schedule, config.num_train_steps, config.beta_min, config.beta_max)
        super().__init__(config, **kwargs)
        self.scheduler = scheduler

    def loss(self, network: BoundVelocity, action: Tensor, mask: Tensor | None) -> Tensor:
        diffusion = Diffusion(network, self.scheduler)
        return noise_prediction_loss(diffusion, action, mask=mask, samples=self.config.samples_per_item)

    def sample(self, network: BoundVelocity, noise: Tensor) -> Tensor:
        """Normalised chunks (B, T, A) from noise of that shape, by all N ancestral steps."""
        diffusion = Diffusion(network, self.scheduler)
        return diffusion.denoise(noise, range(diffusion.steps - 1, -1, -1), self._generators)

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor]) -> "BoundDdpmAssist":
        """See `lerobot_gloves.adapter.Adapter`."""
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        return BoundDdpmAssist(self.velocity(observation), self.scheduler)


class BoundDdpmAssist:
    """The diffusion model of B contexts (see `lerobot_gloves.adapter.BoundAdapter`), which has no scores."""

    def __init__(self, network: BoundVelocity, scheduler: "DDPMScheduler"):
        self.network, self.scheduler = network, scheduler

    @property
    def evaluations(self) -> int:
        return self.network.evaluations

    def select(self, rows: Tensor) -> "BoundDdpmAssist":
        return BoundDdpmAssist(self.network.select(rows), self.scheduler)

    def edit(self, proposal: Tensor, editor: DDPM, **given: Any) -> Tensor:
        return editor(proposal, Reference(Diffusion(self.network, self.scheduler), **given))
