"""A checkpoint's repository on the Hub, to which a calibration or a card is added."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from huggingface_hub import HfApi, hf_hub_download
from huggingface_hub.errors import EntryNotFoundError
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.checkpoints.card import CARD_NAME


def pushed_to(policy: PreTrainedConfig) -> str:
    """The repository that what is found of a checkpoint is pushed to: its own, or of a folder the one it names.

    What was found on the Hub belongs to where it came from, whatever its configuration was once pushed to.

    Raises:
        ValueError: If a folder names none, or the checkpoint's revision is no branch of it.
    """
    path, revision = str(policy.pretrained_path), policy.pretrained_revision
    repo_id = str(policy.repo_id or "") if Path(path).is_dir() else path
    if not repo_id:
        raise ValueError(f"{path} says nothing of a Hub repository to push to: name one by --policy.repo_id")
    if revision:
        branches = [branch.name for branch in HfApi().list_repo_refs(repo_id).branches]
        if revision not in branches:
            raise ValueError(
                f"nothing can be pushed to {revision} of {repo_id}, which is no branch: choose from "
                f"{', '.join(branches)}, or download it and take the folder"
            )
    return repo_id


def push(repo_id: str, revision: str | None, message: str, write: Callable[[Path], None]) -> None:
    """Add files to a repository: those that `write` leaves in a folder, in which the repository's card lies already."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        with suppress(EntryNotFoundError):
            shutil.copy(hf_hub_download(repo_id, CARD_NAME, revision=revision), folder / CARD_NAME)
        write(folder)
        HfApi().upload_folder(repo_id=repo_id, folder_path=folder, revision=revision, commit_message=message)
