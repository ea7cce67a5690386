"""SmolVLA's architecture at its smallest, of random weights; nothing of it is fetched."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from tests.policies.words import SIZE as VOCABULARY
from tests.policies.words import tokenizer

SIZE = 32


@contextmanager
def without_downloads() -> Iterator[None]:
    """SmolVLA asks its backbone's processor for two tokens only, and that needs a package for the names of numbers."""
    tokenizer = SimpleNamespace(fake_image_token_id=6, global_image_token_id=7)
    with patch("lerobot.policies.smolvla.smolvlm_with_expert.AutoProcessor") as processor:
        processor.from_pretrained.return_value = SimpleNamespace(tokenizer=tokenizer)
        yield


def save_backbone(folder: Path) -> Path:
    """Configuration and tokenizer of a vision-language model of two layers."""
    from transformers import SmolVLMConfig

    part = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
    text = {"model_type": "llama", "vocab_size": VOCABULARY, "num_key_value_heads": 2, "head_dim": 8, "pad_token_id": 0}
    vision = {"image_size": SIZE, "patch_size": 8}
    config = SmolVLMConfig(text_config=part | text, vision_config=part | vision, scale_factor=2, pad_token_id=0)
    config.save_pretrained(folder)
    tokenizer(["<fake>", "<global>"]).save_pretrained(folder)
    return folder


def smolvla_options(folder: Path) -> dict[str, Any]:
    return {
        "vlm_model_name": str(save_backbone(folder)),
        "num_steps": 2,
        "num_vlm_layers": 2,
        "max_state_dim": 4,
        "max_action_dim": 4,
        "resize_imgs_with_padding": (SIZE, SIZE),
    }
