"""Policies loaded with their own processors, as the wrapper needs its agent and its adapter."""

from dataclasses import dataclass
from pathlib import Path

from huggingface_hub.constants import SAFETENSORS_SINGLE_FILE
from lerobot import __version__
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from safetensors import SafetensorError

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
        ValueError: If weights or processors are damaged, or made for another version of the policy or of LeRobot; the
            message names the file.
    """
    config.device = device
    path, revision = str(config.pretrained_path), config.pretrained_revision
    # Before the weights: whose processors are missing is another LeRobot's, whatever its weights say.
    preprocess, postprocess = load_processors(config, path, device, revision)
    try:
        policy = _load_weights(config, path, revision)
    except (SafetensorError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "state_dict" not in str(error):
            raise  # such as a device that is full
        reason = str(error).strip().splitlines()[-1].strip()
        raise ValueError(
            f"{Path(path) / SAFETENSORS_SINGLE_FILE} does not hold the weights of the {config.type} beside it "
            f"({reason}): it was not saved whole, or by another LeRobot than this ({__version__})"
        ) from error
    # No `requires_grad_(False)`: whether a weight requires a gradient decides how torch folds a matrix product, also
    # where none is computed, and the agent's actions would differ from the bare agent's in their last bit.
    return LoadedPolicy(policy.to(device).eval(), preprocess, postprocess)


def _load_weights(config: PreTrainedConfig, path: str, revision: str | None) -> PreTrainedPolicy:
    cls = get_policy_class(config.type)
    if not config.use_peft:
        return cls.from_pretrained(path, config=config, revision=revision)
    from peft import PeftConfig, PeftModel

    peft = PeftConfig.from_pretrained(path, revision=revision)
    base = cls.from_pretrained(peft.base_model_name_or_path, config=config, revision=peft.revision)
    return PeftModel.from_pretrained(base, path, config=peft, revision=revision)
