"""A trained checkpoint's folder made ready for the Hub, and pushed whole: weights, processors, calibration and card."""

import json
from pathlib import Path
from typing import Any

from httpx import HTTPError
from huggingface_hub import HfApi
from lerobot.configs import PreTrainedConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME

from lerobot_gloves.checkpoints.calibration import weights_hash
from lerobot_gloves.checkpoints.card import write_card
from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.system.errors import one_line


def renew_card(folder: Path, repo_id: str | None) -> None:
    """Write the card of a checkpoint into its folder, once it has been loaded: what does not load is of no use.

    A policy of another package has none, and a card that somebody has written is left as it is.

    Args:
        folder: The checkpoint's.
        repo_id: Where it will lie on the Hub, which the card's command names; None for nowhere.

    Raises:
        ValueError: If weights, processors or calibration are damaged, or do not belong together.
    """
    config = PreTrainedConfig.from_pretrained(folder)
    config.pretrained_path = folder
    policy: Any = load_policy(config, "cpu").policy
    calibration = getattr(policy, "calibration", None)
    if calibration is not None:
        calibration.check(weights_hash(policy.state_dict()))
    file = folder / TRAIN_CONFIG_NAME
    training = json.loads(file.read_text()) if file.is_file() else {}
    write_card(folder, policy, training, calibration, repo_id)


def push(folder: Path, repo_id: str, *, private: bool | None = None) -> str:
    """Upload a checkpoint's folder with a card that names where it then lies.

    Args:
        folder: The checkpoint's.
        repo_id: The Hub repository, "user/name", which is made if need be.
        private: Whether a new repository is; by default what the organisation's settings say.

    Returns:
        The repository's address.

    Raises:
        ConnectionError: If the Hub cannot be reached, or does not take it.
        ValueError: See `renew_card`.
    """
    renew_card(folder, repo_id)
    api = HfApi()
    try:
        url = api.create_repo(repo_id, private=private, exist_ok=True)
        api.upload_folder(repo_id=repo_id, folder_path=folder, commit_message="Push a checkpoint")
    except (OSError, HTTPError, RuntimeError) as error:
        raise ConnectionError(
            f"the Hub has not got {folder}: {one_line(error)}; if a token is missing, run hf auth login"
        ) from error
    return str(url)
