"""Backbones of a layer or two and random weights, in folders, and the options of the policies that stand on them."""

from pathlib import Path
from typing import Any

from lerobot.configs import NormalizationMode

from tests.policies.words import SIZE, tokenizer

PART = {"hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
GROUPED = PART | {"vocab_size": SIZE, "num_key_value_heads": 1}
QWEN_MARKS = ["<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
QWEN_IDS = {"vision_start_token_id": 6, "vision_end_token_id": 7, "image_token_id": 8, "video_token_id": 9}
CHAT = (
    "{% for message in messages %}{% for part in message.content %}"
    "{% if part.type == 'image' %}<|vision_start|><|image_pad|><|vision_end|>{% else %} {{ part.text }} {% endif %}"
    "{% endfor %}{% endfor %}"
)


def multi_task_dit_options(folder: Path) -> dict[str, Any]:
    """Its CLIPs must have that name."""
    from transformers import CLIPConfig, CLIPModel

    clip = folder / "clip"
    text = PART | {"vocab_size": SIZE, "max_position_embeddings": 8, "eos_token_id": 0}
    vision = PART | {"image_size": 32, "patch_size": 8}
    CLIPModel(CLIPConfig(text_config=text, vision_config=vision, projection_dim=16)).save_pretrained(clip)
    tokenizer().save_pretrained(clip)
    names = {"vision_encoder_name": str(clip), "text_encoder_name": str(clip), "tokenizer_max_length": 8}
    images = {"image_resize_shape": (32, 32), "image_crop_shape": (32, 32)}
    network = {"hidden_dim": 16, "num_heads": 2, "num_layers": 1, "timestep_embed_dim": 16}
    return names | images | network | {"horizon": 8, "num_train_timesteps": 10, "num_inference_steps": 2}


def xvla_options(folder: Path) -> dict[str, Any]:
    """On Florence-2, whose configuration is the policy's own; its actions are normalised, as after a fine-tuning."""
    tokenizer().save_pretrained(folder)
    vision: dict[str, Any] = {"depths": [1], "patch_size": [7], "patch_stride": [8], "patch_padding": [3]}
    vision |= {"patch_prenorm": [False], "embed_dim": [16], "num_heads": [2], "num_groups": [2], "window_size": 4}
    text: dict[str, Any] = {"vocab_size": SIZE, "d_model": 16, "max_position_embeddings": 128, "pad_token_id": 0}
    for side in ("encoder", "decoder"):
        text |= {f"{side}_layers": 1, f"{side}_ffn_dim": 16, f"{side}_attention_heads": 2}
    florence = {"vision_config": vision | {"projection_dim": 16}, "text_config": text, "image_token_id": SIZE - 1}
    names = {"florence_config": florence, "tokenizer_name": str(folder), "tokenizer_max_length": 8}
    network = {"hidden_size": 16, "depth": 1, "num_heads": 2, "len_soft_prompts": 2, "dim_time": 8, "num_domains": 2}
    network |= {"max_len_seq": 128, "action_mode": "auto", "num_denoising_steps": 2}
    normal = {"STATE": NormalizationMode.MEAN_STD, "ACTION": NormalizationMode.MEAN_STD}
    return names | network | {"normalization_mapping": {"VISUAL": NormalizationMode.IDENTITY, **normal}}


def eo1_options(folder: Path) -> dict[str, Any]:
    from transformers import (
        Qwen2_5_VLConfig,
        Qwen2_5_VLForConditionalGeneration,
        Qwen2_5_VLProcessor,
        Qwen2VLImageProcessor,
        Qwen2VLVideoProcessor,
    )

    # Behind the backbone's own marks the policy adds seven.
    text = GROUPED | {"vocab_size": 32, "rope_parameters": _rotations()}
    vision = {"depth": 1, "hidden_size": 16, "intermediate_size": 16, "num_heads": 2, "out_hidden_size": 16}
    vision |= {"patch_size": 14, "window_size": 56, "fullatt_block_indexes": [0]}
    config = Qwen2_5_VLConfig(text_config=text, vision_config=vision, **QWEN_IDS)
    Qwen2_5_VLForConditionalGeneration(config).save_pretrained(folder)
    images, videos = Qwen2VLImageProcessor(), Qwen2VLVideoProcessor()
    Qwen2_5_VLProcessor(images, tokenizer(QWEN_MARKS), videos, chat_template=CHAT).save_pretrained(folder)
    pixels = {"image_min_pixels": 28 * 28, "image_max_pixels": 56 * 56}
    return {"vlm_base": str(folder), "dtype": "float32", "num_denoise_steps": 2, **pixels}


def save_qwen3(folder: Path) -> Path:
    """What VLA-JEPA and GR00T stand on."""
    from transformers import (
        Qwen2VLImageProcessor,
        Qwen3VLConfig,
        Qwen3VLForConditionalGeneration,
        Qwen3VLProcessor,
        Qwen3VLVideoProcessor,
    )

    text = GROUPED | {"head_dim": 8, "rope_parameters": _rotations()}
    vision = {"depth": 1, "hidden_size": 16, "intermediate_size": 16, "num_heads": 2, "out_hidden_size": 16}
    vision |= {"patch_size": 16, "num_position_embeddings": 16, "deepstack_visual_indexes": [0]}
    config = Qwen3VLConfig(text_config=text, vision_config=vision, **QWEN_IDS)
    Qwen3VLForConditionalGeneration(config).save_pretrained(folder)
    images = Qwen2VLImageProcessor(size={"shortest_edge": 32 * 32, "longest_edge": 64 * 64}, patch_size=16)
    words = tokenizer(QWEN_MARKS)
    Qwen3VLProcessor(images, words, Qwen3VLVideoProcessor(), chat_template=CHAT).save_pretrained(folder)
    return folder


def _rotations() -> dict[str, Any]:
    return {"rope_type": "default", "rope_theta": 1e4, "mrope_section": [1, 1, 2]}


def vla_jepa_options(folder: Path) -> dict[str, Any]:
    """Without its world model, which only a training asks."""
    names = {"qwen_model_name": str(save_qwen3(folder)), "enable_world_model": False, "torch_dtype": "float32"}
    heads = {"action_num_heads": 2, "action_attention_head_dim": 8, "num_target_vision_tokens": 2}
    tokens = {"num_embodied_action_tokens_per_instruction": 2, "num_action_tokens_per_timestep": 1}
    network = {"action_hidden_size": 16, "action_num_layers": 1, "action_max_seq_len": 32, **heads, **tokens}
    return names | network | {"num_inference_timesteps": 2}


def evo1_options(folder: Path) -> dict[str, Any]:
    from transformers import InternVLConfig, InternVLModel

    tokenizer(["<img>", "</img>", "<IMG_CONTEXT>"]).save_pretrained(folder)
    vision = PART | {"image_size": (28, 28), "patch_size": (14, 14)}
    config = InternVLConfig(
        text_config=GROUPED | {"model_type": "qwen2"}, vision_config=vision, image_token_id=8, image_seq_length=1
    )
    InternVLModel(config).save_pretrained(folder)
    names = {"vlm_model_name": str(folder), "vlm_num_layers": 1, "vlm_dtype": "float32", "use_flash_attn": False}
    images = {"image_resolution": (28, 28), "max_views": 1, "enable_gradient_checkpointing": False}
    network = {"embed_dim": 16, "hidden_dim": 16, "state_hidden_dim": 16, "num_heads": 2, "num_layers": 1}
    return names | images | network | {"num_inference_timesteps": 2}
