"""An agent asked on the observations of a dataset, as if an episode began at each."""

from collections.abc import Callable
from itertools import count
from typing import Any

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_policy_config
from lerobot.utils.constants import OBS_PREFIX
from lerobot.utils.feature_utils import dataset_to_policy_features
from torch import Tensor

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.features import check_features
from lerobot_gloves.checkpoints.processors import load_processors, renamed
from lerobot_gloves.evaluation.agent import quiet
from lerobot_gloves.recording.agents import Listener


def asked(agent: str, meta: LeRobotDatasetMetadata, device: str) -> Callable[[dict[str, Any]], Tensor]:
    """Load an agent to ask it on a dataset's frames.

    Args:
        agent: Folder or Hub id of any policy.
        meta: What the dataset says of itself.
        device: Where it runs.

    Returns:
        From a batch of B frames to what the agent proposes there, raw (B, n, A), on the CPU. It is asked as the wrapper
        asks it, all that it computes at that moment; one that looks back sees the frame as often as it looks.

    Raises:
        ValueError: If there is no such policy, or the dataset does not have what it observes or its actions.
    """
    own = checkpoint_config("agent", agent)
    before, _ = load_processors(own, agent, device, None)
    needed = {**(own.input_features or {}), **(own.output_features or {})}
    given = dataset_to_policy_features(meta.features)
    check_features("the agent", needed, meta.repo_id, renamed(before, given))
    with quiet():
        policy = make_policy(make_policy_config("gloves", agent=agent, device=device), ds_meta=meta).eval()
    seeds = count()

    def propose(frames: dict[str, Any]) -> Tensor:
        shown = {key: value for key, value in frames.items() if key.startswith(OBS_PREFIX) and key in meta.features}
        # Of a window of frames, as an adapter may load it, the agent is shown the last.
        shown = {key: _last(value, len(meta.features[key]["shape"])) for key, value in shown.items()}
        policy.perturbation = heard = Listener(None)
        policy.reset()
        # Many policies draw from the global generator, and what is asked twice shall be answered alike.
        with torch.random.fork_rng(devices=[]), torch.inference_mode():
            torch.manual_seed(next(seeds))
            policy.select_action({key: value.to(device) for key, value in shown.items()} | {"task": frames["task"]})
        assert heard.proposal is not None, "an episode's first step is a query"
        return heard.proposal.cpu()

    return propose


def _last(value: Tensor, dimensions: int) -> Tensor:
    return value if value.ndim <= 1 + dimensions else value[:, -1]
