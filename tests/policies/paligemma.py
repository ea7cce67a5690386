"""pi0 and pi0.5 at their smallest, of random weights: LeRobot knows the sizes of two PaliGemmas, and no others."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from tests.policies.words import SIZE, tokenizer


@contextmanager
def small_paligemma(_: Path) -> Iterator[None]:
    """Another size for the variants' names, and a tokenizer that is here for the one that is named in the code."""
    from lerobot.policies.pi0 import modeling_pi0
    from lerobot.policies.pi05 import modeling_pi05

    with ExitStack() as patches:
        for module in (modeling_pi0, modeling_pi05):
            gemma = module.GemmaConfig(width=16, depth=1, mlp_dim=16, num_heads=2, num_kv_heads=1, head_dim=8)
            patches.enter_context(patch.object(module, "get_gemma_config", return_value=gemma))
            for name in ("PaliGemmaForConditionalGenerationWithPiGemma", "PiGemmaForCausalLM"):
                patches.enter_context(patch.object(module, name, _shrunk(getattr(module, name))))
        known = patches.enter_context(patch("lerobot.processor.tokenizer_processor.AutoTokenizer"))
        known.from_pretrained.return_value = tokenizer()
        yield


def _shrunk(model: Callable[..., Any]) -> Callable[..., Any]:
    """The same with a vocabulary, and the vision tower if it has one, of a few numbers."""

    def make(config: Any) -> Any:
        if (vision := getattr(config, "vision_config", None)) is not None:
            config.image_token_index = config.image_token_id = SIZE - 1
            vision.hidden_size = vision.intermediate_size = vision.projection_dim = 16
            vision.num_hidden_layers, vision.num_attention_heads = 1, 2
        getattr(config, "text_config", config).vocab_size = SIZE
        return model(config=config)

    return make


def pi_options(_: Path) -> dict[str, Any]:
    return {"num_inference_steps": 2, "image_resolution": (28, 28)}
