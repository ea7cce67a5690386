"""How long a training by configs/own/ takes, by configuration and cameras, in seconds of one core.

The batch is in memory: what reading and decoding cost is for `num_workers` to hide.

    python scripts/benchmark_own.py
"""

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import yaml
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import get_policy_class, make_policy_config
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.system.text import markdown_table

CONFIGS = Path(__file__).parents[1] / "configs" / "own"
JOINTS = 7
"""Entries of the state and of an action."""
CAMERAS = {"state": [(0, 0)], "cameras": [(1, 96), (2, 96), (1, 256), (2, 256)]}
"""By configuration, numbers of cameras and the height and width of their images."""


def configured(name: str) -> dict[str, Any]:
    """A configuration of configs/own/ as it stands there."""
    return yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())


def step_seconds(own: Mapping[str, Any], cameras: int, size: int, steps: int) -> float:
    """Processor seconds of an optimisation step, the mean of `steps` after a first one.

    Args:
        own: The training's configuration, as `configured` reads it.
        cameras: How many there are.
        size: Height and width of their images.
        steps: How many are timed.
    """
    options = dict(own["policy"])
    kind, batch = options.pop("type"), own["batch_size"]
    images = {f"observation.images.{i}": PolicyFeature(FeatureType.VISUAL, (3, size, size)) for i in range(cameras)}
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (JOINTS,)), **images}
    action = {"action": PolicyFeature(FeatureType.ACTION, (JOINTS,))}
    made = {"input_features": inputs, "output_features": action, "device": "cpu", "pretrained_backbone_weights": None}
    config = make_policy_config(kind, **options, **made)
    policy: Any = get_policy_class(kind)(config).train()
    preset = config.get_optimizer_preset()
    optimizer = preset.build(policy.get_optim_params())
    item = {key: torch.rand(batch, *feature.shape) for key, feature in inputs.items()}
    item["action"] = torch.randn(batch, len(config.action_delta_indices), JOINTS)
    item["action_is_pad"] = torch.zeros(item["action"].shape[:2], dtype=torch.bool)
    began = 0.0
    for step in range(steps + 1):
        if step == 1:
            began = time.process_time()
        loss, _ = policy.forward(item)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), preset.grad_clip_norm)
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
    return (time.process_time() - began) / steps


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=3, help="steps that are timed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    register_third_party_plugins()
    lines = [["configs/own/", "cameras", "a step, s", "--steps", "all of them, hours"]]
    for name, sizes in CAMERAS.items():
        own = configured(name)
        for cameras, size in sizes:
            seconds = step_seconds(own, cameras, size, arguments.steps)
            seen = f"{cameras} of {size} x {size}" if cameras else "none"
            hours = seconds * own["steps"] / 3600
            lines.append([f"{name}.yaml", seen, f"{seconds:.2f}", str(own["steps"]), f"{hours:.1f}"])
    print(markdown_table(lines))
    print(f"\n{JOINTS} joints, {own['batch_size']} items a step, on one core of a CPU; a GPU is not measured.")


if __name__ == "__main__":
    main()
