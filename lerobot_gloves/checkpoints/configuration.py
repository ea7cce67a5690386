"""What a checkpoint says of itself, or one clear line if it says nothing."""

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import fields
from pathlib import Path

from draccus.utils import ParsingError
from huggingface_hub.errors import HFValidationError
from lerobot.configs import FeatureType, PreTrainedConfig
from lerobot.envs import EnvConfig
from lerobot.envs.utils import env_to_policy_features

from lerobot_gloves.system.errors import cause


def checkpoint_config(
    option: str, checkpoint: str | Path, overrides: Sequence[str] = (), revision: str | None = None
) -> PreTrainedConfig:
    """The configuration of the policy that an option names, with options such as `--guidance=2` over it.

    Args:
        option: Who names it, such as `policy.adapter`.
        checkpoint: Its folder or Hub id.
        overrides: What goes over it.
        revision: Its Hub revision.

    Raises:
        ValueError: If there is none, or it has no such options.
    """
    told = io.StringIO()
    try:
        with redirect_stderr(told):
            return PreTrainedConfig.from_pretrained(checkpoint, revision=revision, cli_overrides=list(overrides))
    except (FileNotFoundError, NotADirectoryError, HFValidationError) as error:
        raise ValueError(f"--{option}={checkpoint} is no checkpoint's folder, nor one on the Hub in reach") from error
    except ParsingError as error:
        raise ValueError(f"--{option}={checkpoint} with {' '.join(overrides)}: {cause(error)}") from error
    except SystemExit as error:  # how argparse refuses an option, after telling all that there are
        known = ", ".join(f"--{one.name}" for one in fields(type(checkpoint_config(option, checkpoint, (), revision))))
        reason = told.getvalue().strip().splitlines()[-1].partition("error: ")[2]
        raise ValueError(f"--{option}={checkpoint} has {reason}: choose from {known}") from error


def check_fits(agent: PreTrainedConfig, env: EnvConfig) -> None:
    """Refuse an agent for other actions or vectors than the task's; what it makes of images is its own affair.

    Raises:
        ValueError: Naming what differs.
    """
    given = env_to_policy_features(env)
    for key, feature in {**(agent.input_features or {}), **(agent.output_features or {})}.items():
        if feature.type is FeatureType.VISUAL:
            continue
        if key not in given:
            raise ValueError(f"the agent needs {key}, but {env.type} gives only {', '.join(sorted(given))}")
        if tuple(feature.shape) != tuple(given[key].shape):
            raise ValueError(
                f"the agent is made for {key} of shape {tuple(feature.shape)}, but that of {env.type} has "
                f"{tuple(given[key].shape)}"
            )
