"""SmolVLA's architecture at its smallest, of random weights; nothing of it is fetched."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import make_policy_config

CAMERA, SIZE = "observation.images.front", 32


@contextmanager
def without_downloads() -> Iterator[None]:
    """SmolVLA asks its backbone's processor for two tokens only, and that needs a package for the names of numbers."""
    tokenizer = SimpleNamespace(fake_image_token_id=1, global_image_token_id=2)
    with patch("lerobot.policies.smolvla.smolvlm_with_expert.AutoProcessor") as processor:
        processor.from_pretrained.return_value = SimpleNamespace(tokenizer=tokenizer)
        yield


def save_backbone(folder: Path) -> Path:
    """Configuration and tokenizer of a vision-language model of two layers."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast, SmolVLMConfig

    part = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
    text = {"model_type": "llama", "vocab_size": 8, "num_key_value_heads": 2, "head_dim": 8, "pad_token_id": 0}
    vision = {"image_size": SIZE, "patch_size": 8}
    config = SmolVLMConfig(text_config=part | text, vision_config=part | vision, scale_factor=2, pad_token_id=0)
    config.save_pretrained(folder)
    words = Tokenizer(models.WordLevel({"<pad>": 0, "<fake>": 1, "<global>": 2, "<unk>": 3, "move": 4}, "<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    PreTrainedTokenizerFast(tokenizer_object=words, pad_token="<pad>", unk_token="<unk>").save_pretrained(folder)
    return folder


def smolvla_config(backbone: Path, inputs: dict[str, PolicyFeature], outputs: dict[str, PolicyFeature]) -> Any:
    """A policy of chunks of ten actions."""
    return make_policy_config(
        "smolvla",
        input_features={**inputs, CAMERA: PolicyFeature(FeatureType.VISUAL, (3, SIZE, SIZE))},
        output_features=outputs,
        device="cpu",
        push_to_hub=False,
        vlm_model_name=str(backbone),
        chunk_size=10,
        n_action_steps=10,
        num_steps=2,
        num_vlm_layers=2,
        max_state_dim=4,
        max_action_dim=4,
        resize_imgs_with_padding=(SIZE, SIZE),
    )
