"""The episodes that a checkpoint's training run has not seen, read as it read its own."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from draccus.utils import ParsingError
from httpx import HTTPError
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.configs.video import DEFAULT_DEPTH_UNIT
from lerobot.datasets.factory import make_train_eval_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.utils.constants import HF_LEROBOT_HOME
from lerobot.utils.import_utils import get_safe_default_video_backend

from lerobot_gloves.system.errors import cause, one_line


@dataclass
class HeldOutConfig(DatasetConfig):
    """A dataset that is read as a checkpoint's training read its own, but for what is said otherwise."""

    # Decoder of videos; by default the training's.
    video_backend: str | None = None
    # Unit of depth maps, mm or m; by default the training's.
    depth_output_unit: str | None = None

    def __post_init__(self) -> None:
        told = self.depth_output_unit
        self.depth_output_unit = told or DEFAULT_DEPTH_UNIT
        super().__post_init__()
        self.depth_output_unit = told

    def completed(self, training: TrainPipelineConfig | None) -> "HeldOutConfig":
        """The same with the training's choice wherever none was made, LeRobot's where it is not known.

        Of the training's dataset that is also where it lay, if it still does, and its revision.
        """
        own = DatasetConfig(self.repo_id) if training is None else training.dataset
        backend = own.video_backend
        if backend == "torchcodec":  # which the machine of the training may have had, and this one not
            backend = get_safe_default_video_backend()
        read = replace(
            self,
            video_backend=self.video_backend or backend,
            depth_output_unit=self.depth_output_unit or own.depth_output_unit,
        )
        if own.repo_id == self.repo_id:
            read.revision = self.revision or own.revision
            if self.root is None and own.root is not None and Path(own.root).is_dir():
                read.root = own.root
        return read


def load_metadata(dataset: DatasetConfig) -> LeRobotDatasetMetadata:
    """What a dataset's folder, or the Hub, says of it.

    Raises:
        FileNotFoundError: If neither has it.
    """
    try:
        return LeRobotDatasetMetadata(dataset.repo_id, root=dataset.root, revision=dataset.revision)
    except (OSError, HTTPError, RuntimeError) as error:
        folder = dataset.root or HF_LEROBOT_HOME / dataset.repo_id
        raise FileNotFoundError(
            f"there is no dataset {dataset.repo_id} in {folder} (--dataset.root), nor is one to be had from the Hub: "
            f"{one_line(error)}"
        ) from error


def training_config(checkpoint: Path, revision: str | None = None) -> TrainPipelineConfig | None:
    """How a checkpoint was trained, None if it does not say: only `lerobot-train` writes that down.

    Args:
        checkpoint: Its folder, or its Hub id.
        revision: Its Hub revision.

    Raises:
        ValueError: If the file names what is not installed here, such as an environment, or cannot be read.
    """
    # LeRobot would go on without the file, and complain about options that nobody gave.
    if checkpoint.is_dir() and not (checkpoint / TRAIN_CONFIG_NAME).is_file():
        return None
    try:
        return TrainPipelineConfig.from_pretrained(checkpoint, revision=revision)
    except OSError:
        return None
    except (ParsingError, ValueError) as error:
        raise ValueError(
            f"{checkpoint / TRAIN_CONFIG_NAME}, by which the training's episodes are told, cannot be read: "
            f"{one_line(cause(error))}: install the package that brings what it names, or, where that is not the "
            "policy or the dataset, as an environment, delete it from the file"
        ) from error


def held_out_episodes(
    training: TrainPipelineConfig | None, dataset: DatasetConfig, meta: LeRobotDatasetMetadata
) -> list[int]:
    """The episodes to calibrate on, none of which the training run may have seen.

    Args:
        training: How the checkpoint was trained, None if it does not say.
        dataset: The dataset, with the episodes that are asked for, if some are.
        meta: What the dataset says of itself.

    Raises:
        ValueError: If the training run saw them, or the dataset has no such episodes.
    """
    asked, count = dataset.episodes, meta.total_episodes
    if outside := [episode for episode in asked or () if episode >= count]:
        raise ValueError(f"dataset.episodes holds {outside}, but {dataset.repo_id} has episodes 0 to {count - 1}")
    if training is None or training.dataset.repo_id != dataset.repo_id:
        if training is None:
            reason = f"no {TRAIN_CONFIG_NAME} beside the weights"
        else:
            reason = f"the adapter was trained on {training.dataset.repo_id}, not on {dataset.repo_id}"
        logging.warning("%s: cannot check that the training run saw none of these episodes", reason)
        return asked or list(range(count))
    training.dataset.root = dataset.root
    train, held_out = make_train_eval_datasets(training)
    seen = set(train.episodes if train.episodes is not None else range(train.meta.total_episodes))
    untouched = sorted(set(range(meta.total_episodes)) - seen) if held_out is None else list(held_out.episodes)
    chosen = asked or untouched
    overlap = sorted(seen.intersection(chosen))
    if overlap or not chosen:
        raise ValueError(
            f"the training run saw {len(overlap) or 'all'} of these episodes: calibrate on others; "
            "lerobot-train holds some out with --dataset.eval_split=0.1"
        )
    return chosen
