"""Policies loaded with their own processors, as the wrapper needs its agent and its adapter."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from huggingface_hub.constants import SAFETENSORS_SINGLE_FILE
from huggingface_hub.errors import HFValidationError
from lerobot import __version__
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.import_utils import _peft_available
from safetensors import SafetensorError

from lerobot_gloves.checkpoints.content import PEFT_CONFIG
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
        policy = load_weights(config)
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


def load_weights(config: PreTrainedConfig, *, merged: bool = False) -> PreTrainedPolicy:
    """The policy that `config.pretrained_path` names; where it was fine-tuned by PEFT, with PEFT's layers in it.

    Args:
        config: The checkpoint's configuration.
        merged: Whether PEFT's layers become part of the weights, as who trains them further needs it. What is computed
            is then another in its last bits.

    Raises:
        ImportError: If PEFT is needed and not installed.
        ValueError: If the checkpoint that PEFT started from is not where it says.
    """
    path, revision = str(config.pretrained_path), config.pretrained_revision
    cls = get_policy_class(config.type)
    if not config.use_peft:
        return cls.from_pretrained(path, config=config, revision=revision)
    if not _peft_available:
        raise ImportError(f"{path} was fine-tuned by PEFT, which is missing: pip install 'lerobot_policy_gloves[peft]'")
    from peft import PeftConfig, PeftModel

    peft = PeftConfig.from_pretrained(path, revision=revision)
    start = str(peft.base_model_name_or_path)
    try:
        base = cls.from_pretrained(start, config=config, revision=peft.revision)
    except (FileNotFoundError, HFValidationError) as error:
        raise ValueError(
            f"{path} was fine-tuned by PEFT from {start}, which is no checkpoint's folder, nor one on the Hub in "
            f"reach: mend base_model_name_or_path in {PEFT_CONFIG}"
        ) from error
    adapted: Any = PeftModel.from_pretrained(base, path, config=peft, revision=revision)
    return adapted.merge_and_unload() if merged else without_peft(adapted)


def without_peft(policy: Any) -> PreTrainedPolicy:
    """The policy itself, PEFT's layers in it, of what LeRobot loads of a checkpoint that was fine-tuned by PEFT.

    The model that PEFT puts around it only passes on what it is asked, and hides what the policy is.
    """
    return policy.get_base_model() if hasattr(policy, "get_base_model") else policy
