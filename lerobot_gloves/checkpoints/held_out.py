"""The episodes that a checkpoint's training run has not seen."""

import logging
from pathlib import Path

from draccus.utils import ParsingError
from httpx import HTTPError
from lerobot.configs import PreTrainedConfig
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.datasets.factory import make_train_eval_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.utils.constants import HF_LEROBOT_HOME

from lerobot_gloves.system.errors import cause, one_line


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


def training_config(checkpoint: Path) -> TrainPipelineConfig | None:
    """How a checkpoint was trained, None if it does not say: only `lerobot-train` writes that down.

    Raises:
        ValueError: If the file names what is not installed here, such as an environment, or cannot be read.
    """
    # LeRobot would go on without the file, and complain about options that nobody gave.
    if checkpoint.is_dir() and not (checkpoint / TRAIN_CONFIG_NAME).is_file():
        return None
    try:
        return TrainPipelineConfig.from_pretrained(checkpoint)
    except OSError:
        return None
    except (ParsingError, ValueError) as error:
        raise ValueError(
            f"{checkpoint / TRAIN_CONFIG_NAME}, by which the training's episodes are told, cannot be read: "
            f"{one_line(cause(error))}: install the package that brings what it names, or, where that is not the "
            "policy or the dataset, as an environment, delete it from the file"
        ) from error


def held_out_episodes(policy: PreTrainedConfig, dataset: DatasetConfig, meta: LeRobotDatasetMetadata) -> list[int]:
    """The episodes to calibrate on, none of which the training run may have seen.

    Args:
        policy: The checkpoint's configuration, with its `pretrained_path`.
        dataset: The dataset, with the episodes that are asked for, if some are.
        meta: What the dataset says of itself.

    Raises:
        ValueError: If the training run saw them, or the dataset has no such episodes.
    """
    asked, count = dataset.episodes, meta.total_episodes
    if outside := [episode for episode in asked or () if episode >= count]:
        raise ValueError(f"dataset.episodes holds {outside}, but {dataset.repo_id} has episodes 0 to {count - 1}")
    training = training_config(Path(str(policy.pretrained_path)))
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
