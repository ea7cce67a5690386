"""Denoising diffusion with the schedules and steps of diffusers (Ho et al. 2020, "DDPM").

Step k, from 0 to N - 1, is diffusers' timestep: x_k = sqrt(abar_k) action + sqrt(1 - abar_k) noise, where abar_k is the
product of 1 - beta_0 to 1 - beta_k. Even x_0 holds a trace of noise.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor

from lerobot_gloves.flow import VelocityField, mean_per_chunk
from lerobot_gloves.generators import Generators, randn

if TYPE_CHECKING:
    from diffusers.schedulers.scheduling_ddpm import DDPMScheduler


def noise_scheduler(schedule: str, steps: int, beta_min: float, beta_max: float) -> "DDPMScheduler":
    """Betas of a schedule that diffusers knows, and its ancestral steps with the original's sigma_k = sqrt(beta_k).

    Args:
        schedule: One of `SCHEDULES`; "sigmoid" is beta = beta_min + (beta_max - beta_min) sigmoid(u), u from -6 to 6.
        steps: N.
        beta_min: First beta of "linear", lower bound of "sigmoid".
        beta_max: Last beta of "linear", upper bound of "sigmoid".

    Raises:
        ImportError: If diffusers is not installed.
    """
    try:
        import diffusers
    except ImportError:
        raise ImportError(
            'ddpm_assist needs diffusers, of the extra ddpm: pip install "lerobot_policy_gloves[ddpm]"'
        ) from None
    scheduler = cast("type[DDPMScheduler]", diffusers.DDPMScheduler)  # typed as what it is without torch
    return scheduler(
        num_train_timesteps=steps,
        beta_schedule=schedule,
        beta_start=beta_min,
        beta_end=beta_max,
        variance_type="fixed_large",
        clip_sample=False,
    )


@dataclass(frozen=True)
class Diffusion:
    """A network that predicts noise, and the schedule that it was trained for.

    Attributes:
        network: epsilon(x, t), any callable (N, T, A), (N,) -> (N, T, A), its context bound.
        scheduler: The schedule.
    """

    network: VelocityField
    scheduler: "DDPMScheduler"

    @property
    def steps(self) -> int:
        """N."""
        return len(self.scheduler.betas)

    def predict(self, x: Tensor, step: Tensor) -> Tensor:
        """The noise in x_k, (N, T, A), at steps k, integers (N,).

        What the network is told of step k is t = 1 - (k + 1) / N. As for a flow, 0 is noise and the clean action,
        which is no step, would be 1.
        """
        return self.network(x, 1 - (step.to(x) + 1) / self.steps)

    def noised(self, action: Tensor, noise: Tensor, step: Tensor) -> Tensor:
        """x_k, (N, T, A), of actions and noise of that shape, at steps k, integers (N,): the closed-form kernel."""
        return self.scheduler.add_noise(action, noise, cast(Any, step))

    def denoise(self, x: Tensor, steps: Iterable[int], generator: Generators) -> Tensor:
        """Ancestral steps: each of the `steps` k, in falling order, takes x_k (N, T, A) to x_{k-1}, or 0 to the action.

        x_{k-1} = (x_k - beta_k / sqrt(1 - abar_k) epsilon(x_k, k)) / sqrt(1 - beta_k) + sqrt(beta_k) z, and without z
        at step 0.

        Args:
            x: x_k of the first of the steps.
            steps: Adjacent steps.
            generator: Source of z; a sequence holds one for each of the N rows.
        """
        # diffusers shares a generator out row by row if it is in a list, as `randn` does. Its annotations do not tell.
        sources = generator if generator is None or isinstance(generator, torch.Generator) else list(generator)
        for k in steps:
            noise = self.predict(x, torch.full((len(x),), k, device=x.device))
            x = self.scheduler.step(noise, k, x, generator=cast(Any, sources), return_dict=False)[0]
        return x


def noise_prediction_loss(
    diffusion: Diffusion,
    action: Tensor,
    *,
    mask: Tensor | None = None,
    samples: int = 1,
    generator: torch.Generator | None = None,
) -> Tensor:
    """E ||epsilon(x_k, k) - noise||^2, mean per action, of every chunk, k uniform (Ho et al. 2020, equation 14).

    Args:
        diffusion: The noise prediction, bound to the B contexts of `action`.
        action: Expert chunks, shape (B, T, A).
        mask: True where an action counts, shape (B, T); padding is left out of the mean. None: all count.
        samples: Independent draws of noise and of the step per chunk.
        generator: Source of the draws.

    Returns:
        Loss per chunk, shape (B,); 0 for a chunk that is all padding.
    """
    clean = action.repeat_interleave(samples, dim=0)
    noise = randn(clean.shape, generator, like=clean)
    device = clean.device if generator is None else generator.device
    step = torch.randint(diffusion.steps, clean.shape[:1], generator=generator, device=device).to(clean.device)
    error = (diffusion.predict(diffusion.noised(clean, noise, step), step) - noise).square()
    return mean_per_chunk(error, samples, mask)
