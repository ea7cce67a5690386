"""An agent that steers a straight line to the right of all pillars, and adapters that know nothing."""

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.policies import get_policy_class, make_policy_config, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy

from tests.builders import FLOW, awaken, calibrate, features, make_policy, save_policy, statistics

RIGHTMOST_SEED = 10007
"""The environment seed, among the first of the test band, whose corridor is the one that the agent steers through."""


def save(folder: Path, kind: str, std: float, policy: PreTrainedPolicy | None = None, **options: int) -> Path:
    """Save a tiny policy whose actions scatter around the straight line through corridor "1 2 3"."""
    policy = policy or make_policy(kind, **options)
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


@pytest.fixture(scope="session")
def align_flow(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Trained, it says, on the expert and on the agent as it is and noised; without a calibration."""
    return str(save(tmp_path_factory.mktemp("align_flow"), "gloves_align_flow", std=0.003, seed=2))


def make_baseline(kind: str, **options: object) -> PreTrainedPolicy:
    """A tiny one, every weight of which matters."""
    inputs, outputs = features()
    made = {"input_features": inputs, "output_features": outputs, "device": "cpu", "push_to_hub": False}
    small = {key: value for key, value in FLOW.items() if key != "num_inference_steps"}
    config = make_policy_config(kind, **{**made, **small, **options})
    with torch.random.fork_rng():
        torch.manual_seed(3)
        policy = get_policy_class(kind)(config)
        if not options:  # what is distilled has its teacher's weights
            awaken(policy)
    return policy.eval()


@pytest.fixture(scope="session")
def diffusion(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An adapter without scores."""
    folder = tmp_path_factory.mktemp("diffusion")
    return str(save(folder, "ddpm_assist", std=0.003, policy=make_baseline("ddpm_assist")))


@pytest.fixture(scope="session")
def student(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("csa")
    teacher = save(folder / "teacher", "csa_assist", std=0.003, policy=make_baseline("csa_assist"))
    distilled = make_baseline("csa_assist", stage="student", teacher=str(teacher))
    return str(save(folder / "student", "csa_assist", std=0.003, policy=distilled))
