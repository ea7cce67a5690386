"""What `lerobot-train` costs beyond the network, as ratios of flow samples a second measured in one run.

Three loops with the same network, optimiser and batch: stock `lerobot-train` (the difference of two runs, so that its
start does not count), a bare loop over the same loader and processors, and a bare loop over tensors already in memory.
Image encoders, if the data has cameras, begin with random weights.

    python scripts/benchmark_training.py --dataset=<folder of a LeRobotDataset>
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from itertools import cycle
from pathlib import Path
from typing import Any

import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.policies.factory import make_policy_config
from lerobot.utils.import_utils import register_third_party_plugins
from torch.utils.data import DataLoader

REPO_ID = "benchmark/data"


def train_seconds(dataset: Path, steps: int, batch: int) -> float:
    """Wall time of `lerobot-train` for so many steps."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        subprocess.run(
            [
                str(Path(sys.executable).with_name("lerobot-train")),
                "--policy.type=gloves_expert_flow",
                "--policy.device=cpu",
                "--policy.push_to_hub=false",
                "--policy.pretrained_backbone_weights=null",
                f"--dataset.repo_id={REPO_ID}",
                f"--dataset.root={dataset}",
                f"--output_dir={folder}/run",
                f"--batch_size={batch}",
                f"--steps={steps}",
                "--num_workers=0",
                "--save_checkpoint=false",
            ],
            check=True,
            capture_output=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"},
        )
        return time.perf_counter() - began


class Loop:
    """The same optimisation step, on whatever batch it is handed."""

    def __init__(self, dataset: Path, batch: int):
        meta = LeRobotDatasetMetadata(REPO_ID, root=dataset)
        config = make_policy_config("gloves_expert_flow", device="cpu", pretrained_backbone_weights=None)
        self.policy: Any = make_policy(config, ds_meta=meta)
        self.preprocess, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
        preset = config.get_optimizer_preset()
        self.optimizer = preset.build(self.policy.get_optim_params())
        self.clip = preset.grad_clip_norm
        self.samples = batch * config.samples_per_item
        data = LeRobotDataset(REPO_ID, root=dataset, delta_timestamps=resolve_delta_timestamps(config, meta))
        self.loader = DataLoader(data, batch_size=batch, shuffle=True, drop_last=True)

    def step(self, batch: dict[str, Any]) -> None:
        """One step of training on a preprocessed batch."""
        self.policy.train()
        loss, _ = self.policy.forward(batch)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.clip)
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.policy.update()

    def loaded_rate(self, steps: int) -> float:
        """Flow samples a second over the loader."""
        batches = iter(self.loader)
        began = time.perf_counter()
        for _ in range(steps):
            self.step(self.preprocess(next(batches)))
        return steps * self.samples / (time.perf_counter() - began)

    def memory_rate(self, steps: int) -> float:
        """Flow samples a second over a few batches kept in memory."""
        batches = iter(self.loader)
        kept = cycle([self.preprocess(next(batches)) for _ in range(8)])
        began = time.perf_counter()
        for _ in range(steps):
            self.step(next(kept))
        return steps * self.samples / (time.perf_counter() - began)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dataset", type=Path, required=True, help="folder of a LeRobotDataset")
    parser.add_argument("--batch", type=int, default=8, help="items a step")
    parser.add_argument("--steps", type=int, default=300, help="steps that are timed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    register_third_party_plugins()

    short = train_seconds(arguments.dataset, 20, arguments.batch)
    long = train_seconds(arguments.dataset, 20 + arguments.steps, arguments.batch)
    loop = Loop(arguments.dataset, arguments.batch)
    loop.memory_rate(20)
    train = arguments.steps * loop.samples / (long - short)
    loaded, memory = loop.loaded_rate(arguments.steps), loop.memory_rate(arguments.steps)
    print(f"lerobot-train {train:.0f}, loop over the loader {loaded:.0f}, loop in memory {memory:.0f} flow samples/s")
    print(f"lerobot-train / loop in memory: {train / memory:.2f}x")
    print(f"lerobot-train / loop over the loader: {train / loaded:.2f}x")


if __name__ == "__main__":
    main()
