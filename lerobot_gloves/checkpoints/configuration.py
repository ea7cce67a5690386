"""What a checkpoint says of itself, or one clear line if it says nothing."""

import io
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import fields
from pathlib import Path

from draccus.utils import ParsingError
from huggingface_hub.constants import CONFIG_NAME
from huggingface_hub.errors import HFValidationError
from lerobot import __version__
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.system.errors import cause, one_line


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
        ValueError: If there is none, it has no such options, or it is of another LeRobot or a package that is not here.
    """
    told = io.StringIO()
    named = f"--{option}={checkpoint}" if revision is None else f"--{option}={checkpoint} at revision {revision}"
    try:
        with redirect_stderr(told):
            return PreTrainedConfig.from_pretrained(checkpoint, revision=revision, cli_overrides=list(overrides))
    except (FileNotFoundError, NotADirectoryError, HFValidationError) as error:
        raise ValueError(f"{named} is no checkpoint's folder, nor one on the Hub in reach") from error
    except ParsingError as error:
        if overrides:
            raise ValueError(f"{named} with {' '.join(overrides)}: {cause(error)}") from error
        raise ValueError(
            f"{named}: its {CONFIG_NAME} is not one of this LeRobot ({__version__}): "
            f"{one_line(cause(error))}: save it anew by this one, or mend the file"
        ) from error
    except ValueError as error:  # no JSON, or a type of policy that nobody has registered, which LeRobot lists all of
        reason = one_line(error).partition(" Available policy types")[0]
        raise ValueError(f"{named}: its {CONFIG_NAME}: {reason} Mend it, or install what brings it") from error
    except SystemExit as error:  # how argparse refuses an option, after telling all that there are
        known = ", ".join(f"--{one.name}" for one in fields(type(checkpoint_config(option, checkpoint, (), revision))))
        reason = told.getvalue().strip().splitlines()[-1].partition("error: ")[2]
        raise ValueError(f"{named} has {reason}: choose from {known}") from error
