"""An agent flow from a checkpoint of its own, beside an expert flow's."""

from collections.abc import Callable, Mapping

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_gloves.checkpoints.features import check_features
from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.checkpoints.processors import Pipeline, load_processors
from lerobot_gloves.networks import BoundVelocity

from .configuration_gloves_expert_flow import GlovesExpertFlowConfig


def load_agent_flow(expert: GlovesExpertFlowConfig) -> Callable[[Mapping[str, Tensor]], BoundVelocity]:
    """What binds v_u, of the checkpoint that `expert.agent_flow` names, to the contexts of normalised observations.

    IFAE subtracts two fields, so both must live in one space. A flow cannot be carried over from another normalisation:
    rescaling an action rescales the noise that it is mixed with.

    Args:
        expert: Settings of an expert flow that was loaded from a checkpoint.

    Raises:
        ValueError: If the checkpoint is no align flow, or its chunks, observations or normalisation are others.
    """
    path = str(expert.agent_flow)
    config = PreTrainedConfig.from_pretrained(path)
    if config.type != "gloves_align_flow":
        raise ValueError(
            f"agent_flow={path} is a policy of type {config.type!r}, but must be a gloves_align_flow, which learns "
            "from an agent's proposals"
        )
    config.pretrained_path = path
    config.agent_source = expert.agent_source or config.agent_source
    config.resolve_agent_source()  # a wrong one shall not wait for the first chunk
    if config.chunk_size != expert.chunk_size:
        raise ValueError(
            f"agent_flow={path} has chunks of {config.chunk_size} actions, but the expert flow of {expert.chunk_size}"
        )
    ours, theirs = ({**one.input_features, **one.output_features} for one in (expert, config))
    for who, needed, giver, given in (
        (f"agent_flow={path}", theirs, "the expert flow", ours),
        ("the expert flow", ours, f"agent_flow={path}", theirs),
    ):
        check_features(who, needed, giver, given, advice="train both on the same features")
    loaded = load_policy(config, expert.device)
    preprocess, _ = load_processors(expert, str(expert.pretrained_path), expert.device, expert.pretrained_revision)
    different = differently_normalised(expert, preprocess, loaded.preprocess)
    if different:
        raise ValueError(
            f"agent_flow={path} normalises {', '.join(different)} otherwise than the expert flow: train both on one "
            "merged dataset, each on its own episodes by --dataset.episodes"
        )
    return loaded.policy.requires_grad_(False).agent_velocity


def differently_normalised(config: PreTrainedConfig, one: Pipeline, other: Pipeline) -> list[str]:
    """Features that two preprocessors do not map alike; their maps are affine, so two points tell."""
    shapes = {**config.input_features, ACTION: config.action_feature}
    different = set()
    for value in (0.0, 1.0):
        probe = {key: torch.full((1, *feature.shape), value) for key, feature in shapes.items()}
        ours, theirs = one(dict(probe)), other(dict(probe))
        different |= {key for key in shapes if not torch.allclose(ours[key], theirs[key], rtol=1e-4)}
    return sorted(different)
