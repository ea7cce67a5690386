"""An agent that steers a straight line to the right of all pillars, and an adapter that knows nothing."""

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.policies import make_pre_post_processors

from tests.builders import calibrate, features, make_policy, save_policy, statistics

QUICK = ["--env.type=gloves_slalom", "--env.episode_length=20", "--episodes=3", "--num_workers=1"]
RIGHTMOST_SEED = 10007
"""The environment seed, among the first of the test band, whose corridor is the one that the agent steers through."""


def save(folder: Path, kind: str, std: float, **options: int) -> Path:
    """Save a tiny policy whose actions scatter around the straight line through corridor "1 2 3"."""
    policy = make_policy(kind, **options)
    save_policy(folder, kind, policy=policy)
    inputs, outputs = features()
    stats = statistics({**inputs, **outputs})
    mean, deviation = np.array([0.0024, 0.006], np.float32), np.full(2, std, np.float32)
    stats["action"] = {"mean": mean, "std": deviation, "min": mean - deviation, "max": mean + deviation}
    for pipeline in make_pre_post_processors(policy.config, dataset_stats=stats):
        pipeline.save_pretrained(folder)
    return folder


@pytest.fixture(scope="session")
def agent(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(save(tmp_path_factory.mktemp("agent"), "gloves_flow_policy", std=0.002))


@pytest.fixture(scope="session")
def adapter(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Calibrated so that its gate edits some chunks and admits others."""
    folder = save(tmp_path_factory.mktemp("adapter"), "gloves_expert_flow", std=0.003, seed=1)
    scores = torch.linspace(0, 20, 200).expand(6, -1)
    return str(calibrate(folder, scores={"reverse:steps=1": scores}))


@pytest.fixture
def options(tmp_path: Path, agent: str, adapter: str) -> list[str]:
    return [*QUICK, f"--agent={agent}", f"--adapter={adapter}", f"--output_dir={tmp_path / 'rows'}"]
