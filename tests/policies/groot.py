"""GR00T N1.7 at its smallest, of random weights, without the package dm-tree, of which it asks one function."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from tests.policies.backbones import save_qwen3

HORIZON = 12
"""Actions that the network draws."""


def _map(change: Callable[[Any], Any], batch: Any) -> Any:
    return type(batch)({key: change(value) for key, value in batch.items()})


@contextmanager
def without_dm_tree(folder: Path) -> Iterator[None]:
    """The processor of its backbone's name is the one in `folder`."""
    from lerobot.policies.groot import groot_n1_7, processor_groot

    build = processor_groot._build_n1_7_processor
    with (
        patch.object(groot_n1_7, "tree", SimpleNamespace(map_structure=_map)),
        patch.object(groot_n1_7, "require_package"),
        patch.object(processor_groot, "_build_n1_7_processor", lambda _: build(str(folder / "qwen"))),
    ):
        yield


def groot_options(folder: Path) -> dict[str, Any]:
    """The checkpoint that it starts from is NVIDIA's, not LeRobot's."""
    from lerobot.policies.groot.groot_n1_7 import GR00T_N1_7_DEFAULTS, GR00TN17, GR00TN17Config

    heads = {"num_attention_heads": 2, "attention_head_dim": 8}
    config = GR00TN17Config(
        model_name=str(save_qwen3(folder / "qwen")),
        model_dtype="float32",
        dtype="float32",
        backbone_embedding_dim=16,
        select_layer=1,
        max_state_dim=8,
        max_action_dim=8,
        action_horizon=HORIZON,
        hidden_size=16,
        input_embedding_dim=16,
        max_seq_len=32,
        diffusion_model_cfg=GR00T_N1_7_DEFAULTS["diffusion_model_cfg"] | heads | {"num_layers": 2, "output_dim": 16},
        vl_self_attention_cfg=GR00T_N1_7_DEFAULTS["vl_self_attention_cfg"] | heads | {"num_layers": 1},
        num_inference_timesteps=2,
    )
    GR00TN17(config, load_backbone_weights=False).save_pretrained(folder / "base")
    # Of that embodiment's chunks NVIDIA executes eight actions, whatever a user asks for.
    libero = {"libero_sim": {"action": {"delta_indices": list(range(HORIZON))}}}
    processor = {"processor_kwargs": {"modality_configs": libero}}
    (folder / "base" / "processor_config.json").write_text(json.dumps(processor))
    return {"base_model_path": str(folder / "base"), "max_state_dim": 8, "max_action_dim": 8, "use_bf16": False}
