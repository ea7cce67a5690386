"""FlashBack's consistency shared autonomy (Sun et al., CoRL 2025), for action chunks: a baseline of the benchmark."""

from .configuration_csa_assist import CsaAssistConfig

__all__ = ["CsaAssistConfig"]
