"""A person as an agent that a wrapper can name: a checkpoint without weights."""

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lerobot.configs import PolicyFeature
from lerobot.policies import make_policy_config, make_pre_post_processors
from lerobot.utils.constants import ACTION

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.evaluation.agent import quiet


@contextmanager
def saved_person(
    features: Mapping[str, PolicyFeature], options: Mapping[str, Any], device: str | None = None, **facts: Any
) -> Iterator[str]:
    """A checkpoint of `gloves_person`, there until the wrapper has read it.

    Args:
        features: What there is to observe, and the action.
        options: The wrapper's options for its adapter, whose chunk is as long as the proposals are to be.
        device: Where the adapter computes; None for LeRobot's choice.
        **facts: Other fields of the person's configuration.
    """
    length = 1
    if adapter := options.get("adapter"):
        overrides, revision = options.get("adapter_overrides") or (), options.get("adapter_revision")
        length = checkpoint_config("policy.adapter", adapter, overrides, revision).chunk_size
    with quiet():  # LeRobot warns where there is no GPU
        person = make_policy_config(
            "gloves_person",
            chunk_size=length,
            input_features={key: one for key, one in features.items() if key != ACTION},
            output_features={ACTION: features[ACTION]},
            **({} if device is None else {"device": device}),
            **facts,
        )
    with tempfile.TemporaryDirectory() as folder:
        checkpoint = Path(folder) / "person"  # the name by which the wrapper's start line calls its agent
        person.save_pretrained(checkpoint)
        for pipeline in make_pre_post_processors(person):
            pipeline.save_pretrained(checkpoint)
        yield str(checkpoint)
