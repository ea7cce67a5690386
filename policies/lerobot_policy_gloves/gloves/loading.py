"""Policies loaded with their own processors, as the wrapper needs its agent and its adapter."""

from dataclasses import dataclass
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline


@dataclass
class LoadedPolicy:
    """A policy that acts but does not learn, its preprocessor and its postprocessor.

    Not a module, so that whoever holds it does not save its weights as its own.
    """

    policy: PreTrainedPolicy
    preprocess: PolicyProcessorPipeline[Any, Any]
    postprocess: PolicyProcessorPipeline[Any, Any]

    def reset(self) -> None:
        """A new episode begins."""
        self.policy.reset()
        self.preprocess.reset()
        self.postprocess.reset()


def load_policy(config: PreTrainedConfig, device: str) -> LoadedPolicy:
    """Load the policy that `config.pretrained_path` names, adapted by PEFT or not, with its processors."""
    config.device = device
    cls, path, revision = get_policy_class(config.type), str(config.pretrained_path), config.pretrained_revision
    if config.use_peft:
        from peft import PeftConfig, PeftModel

        peft = PeftConfig.from_pretrained(path, revision=revision)
        base = cls.from_pretrained(peft.base_model_name_or_path, config=config, revision=peft.revision)
        policy = PeftModel.from_pretrained(base, path, config=peft, revision=revision)
    else:
        policy = cls.from_pretrained(path, config=config, revision=revision)
    # The processors' saved device is where the policy was trained.
    overrides = {"device_processor": {"device": device}}
    preprocess, postprocess = make_pre_post_processors(
        config, path, pretrained_revision=revision, preprocessor_overrides=overrides
    )
    # No `requires_grad_(False)`: whether a weight requires a gradient decides how torch folds a matrix product, also
    # where none is computed, and the agent's actions would differ from the bare agent's in their last bit.
    return LoadedPolicy(policy.to(device).eval(), preprocess, postprocess)
