"""Policies loaded with their own processors, as the wrapper needs its agent and its adapter."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy

from lerobot_gloves.checkpoints.processors import Pipeline, load_processors


@dataclass
class LoadedPolicy:
    """A policy that acts but does not learn, its preprocessor and its postprocessor.

    Not a module, so that whoever holds it does not save its weights as its own.
    """

    policy: PreTrainedPolicy
    preprocess: Pipeline
    postprocess: Pipeline

    def reset(self) -> None:
        """A new episode begins."""
        self.policy.reset()
        self.preprocess.reset()
        self.postprocess.reset()


def load_policy(config: PreTrainedConfig, device: str) -> LoadedPolicy:
    """Load the policy that `config.pretrained_path` names, adapted by PEFT or not, with its processors.

    Raises:
        ValueError: If the processors are damaged; what is wrong with the weights is the policy's to say.
    """
    config.device = device
    cls, path, revision = get_policy_class(config.type), str(config.pretrained_path), config.pretrained_revision
    if config.use_peft:
        from peft import PeftConfig, PeftModel

        peft = PeftConfig.from_pretrained(path, revision=revision)
        base = cls.from_pretrained(peft.base_model_name_or_path, config=config, revision=peft.revision)
        policy = PeftModel.from_pretrained(base, path, config=peft, revision=revision)
    else:
        policy = cls.from_pretrained(path, config=config, revision=revision)
    preprocess, postprocess = load_processors(config, path, device, revision)
    # No `requires_grad_(False)`: whether a weight requires a gradient decides how torch folds a matrix product, also
    # where none is computed, and the agent's actions would differ from the bare agent's in their last bit.
    return LoadedPolicy(policy.to(device).eval(), preprocess, postprocess)
