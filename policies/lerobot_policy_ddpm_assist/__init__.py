"""Shared autonomy by diffusion, "To the Noise and Back" (Yoneda et al., RSS 2023), for action chunks: a baseline.

What needs diffusers (the extra `ddpm`) imports it on use, so the plugin loads without it.
"""

from .configuration_ddpm_assist import DdpmAssistConfig

__all__ = ["DdpmAssistConfig"]
