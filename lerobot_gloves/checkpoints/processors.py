"""The processors that a checkpoint was saved with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from huggingface_hub import hf_hub_download
from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.pipeline import ProcessorMigrationError
from lerobot.utils.constants import POLICY_PREPROCESSOR_DEFAULT_NAME
from safetensors import SafetensorError, safe_open

MIGRATION = "lerobot.processor.migrate_policy_normalization"
"""LeRobot's module that makes processors of an older checkpoint's weights; what its error names lies in no wheel."""

type Pipeline = PolicyProcessorPipeline[Any, Any]


def load_processors(
    config: PreTrainedConfig, checkpoint: str, device: str | None, revision: str | None = None
) -> tuple[Pipeline, Pipeline]:
    """Preprocessor and postprocessor of a checkpoint, a folder or a Hub id, for that device.

    The device that they were saved with is where the policy was trained.

    Raises:
        ValueError: If there are none, as an older LeRobot had none, or a file of theirs is damaged; LeRobot's errors do
            not say which, or say it on a page.
    """
    overrides = {"device_processor": {"device": device}}
    try:
        return make_pre_post_processors(
            config, checkpoint, pretrained_revision=revision, preprocessor_overrides=overrides
        )
    except ProcessorMigrationError as error:
        at = "" if revision is None else f" --revision {revision}"
        raise ValueError(
            f"{checkpoint} was saved by an older LeRobot, with its normalisation among the weights and no "
            f"{POLICY_PREPROCESSOR_DEFAULT_NAME}.json: run python -m {MIGRATION} "
            f"--pretrained-path {checkpoint}{at} --output-dir <folder>, and name that folder"
        ) from error
    except SafetensorError as error:
        raise ValueError(f"{_damaged(checkpoint, revision)} is not a readable safetensors file: {error}") from error


def renamed[T](preprocess: Pipeline, features: Mapping[str, T]) -> dict[str, T]:
    """Features under the names that a preprocessor gives them."""
    names = {key: name for step in preprocess.steps for key, name in getattr(step, "rename_map", {}).items()}
    return {names.get(key, key): one for key, one in features.items()}


def _damaged(checkpoint: str, revision: str | None) -> Path:
    """The first file of the processors that cannot be read."""
    folder = Path(checkpoint)
    if not folder.is_dir():
        # All files of a revision lie in one folder of the Hub's cache.
        folder = Path(hf_hub_download(checkpoint, f"{POLICY_PREPROCESSOR_DEFAULT_NAME}.json", revision=revision)).parent
    return next((file for file in sorted(folder.glob("*processor*.safetensors")) if not _readable(file)), folder)


def _readable(file: Path) -> bool:
    try:
        with safe_open(file, framework="pt"):
            return True
    except SafetensorError:
        return False
