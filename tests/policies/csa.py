"""Tiny teachers and students of consistency shared autonomy, and something to learn."""

from pathlib import Path

import torch
from lerobot.policies import get_policy_class, make_policy_config
from lerobot.policies.pretrained import PreTrainedPolicy

from tests.builders import FLOW, awaken, features, observation, save_policy

T = FLOW["chunk_size"]


def make_csa(obs_type: str = "state", *, seed: int = 0, **options: object) -> PreTrainedPolicy:
    """A tiny policy, every weight of which matters."""
    inputs, outputs = features(obs_type)
    made = {"input_features": inputs, "output_features": outputs, "device": "cpu", "push_to_hub": False}
    config = make_policy_config("csa_assist", **{**made, **FLOW, **options})
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        policy = get_policy_class("csa_assist")(config)
        if config.stage == "teacher":
            awaken(policy)
    return policy.eval()


def save_teacher(folder: Path, obs_type: str = "state", **options: object) -> Path:
    """A teacher whose trained and averaged weights differ, on disk."""
    policy = make_csa(obs_type, **options)
    with torch.no_grad():
        for parameter in policy.network.parameters():
            parameter.add_(0.02)
    return save_policy(folder, "csa_assist", policy=policy)


def load(folder: Path) -> PreTrainedPolicy:
    return get_policy_class("csa_assist").from_pretrained(folder)


def data_of(rows: int, seed: int = 0) -> dict[str, torch.Tensor]:
    """Training data in which a chunk is one of two functions of the state."""
    observed = observation(rows, seed=seed)
    side = torch.where(torch.arange(rows) % 2 == 0, 1.0, -1.0)[:, None, None]
    along = torch.linspace(-1, 1, T)[:, None]
    return {**observed, "action": observed["observation.state"][:, None, :2] / 2 + along + side}


def same(first: dict, second: dict) -> bool:
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)
