"""An adapter on expert's data that its training has not seen, read as the training read its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig, parser
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_gloves.adapter import Adapter
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.features import check_features, check_rate
from lerobot_gloves.checkpoints.held_out import HeldOutConfig, held_out_episodes, load_metadata, training_config
from lerobot_gloves.checkpoints.loading import load_policy
from lerobot_gloves.checkpoints.processors import Pipeline, renamed
from lerobot_gloves.system.values import NOTHING, text_value


@dataclass(frozen=True)
class AdapterOnData:
    """What `open_adapter` found.

    Attributes:
        adapter: The adapter, in evaluation mode.
        preprocess: Its preprocessor.
        training: How it was trained, None if it does not say.
        data: How the dataset is read.
        meta: What the dataset says of itself.
        episodes: Its episodes that were asked for, or else those that the training has not seen.
        tolerance_s: How far its time stamps may be off.
    """

    adapter: Any
    preprocess: Pipeline
    training: TrainPipelineConfig | None
    data: HeldOutConfig
    meta: LeRobotDatasetMetadata
    episodes: list[int]
    tolerance_s: float

    @property
    def trained(self) -> Mapping[str, Any]:
        """The training's configuration as `train_config.json` holds it; empty where it is not known."""
        return {} if self.training is None else self.training.to_dict()

    @property
    def lengths(self) -> list[int]:
        """Frames of each of its `episodes`."""
        return [int(self.meta.episodes["length"][episode]) for episode in self.episodes]

    def frames(self, episodes: Sequence[int], indices: Sequence[int]) -> LeRobotDataset:
        """The frames of some episodes, each with the actions at these distances from it."""
        return LeRobotDataset(
            self.data.repo_id,
            root=self.data.root,
            episodes=list(episodes),
            # Of actions what is asked for, whatever window the adapter was trained on.
            delta_timestamps={
                **(resolve_delta_timestamps(self.adapter.config, self.meta) or {}),
                ACTION: [index / self.meta.fps for index in indices],
            },
            revision=self.data.revision,
            video_backend=self.data.video_backend,
            depth_output_unit=self.data.depth_output_unit,
            tolerance_s=self.tolerance_s,
        )


def named_adapter() -> PreTrainedConfig:
    """The configuration of the adapter that `--policy.path` names, with what else was typed of it.

    Its `pretrained_path` is that path, its `pretrained_revision` what was typed.

    Raises:
        ValueError: If none is named, there is no checkpoint, or it has no such options.
    """
    path = parser.get_path_arg("policy")
    if not path:
        raise ValueError("--policy.path is missing, a trained checkpoint")
    typed, written = parser.get_cli_overrides("policy") or [], parser.get_yaml_overrides("policy")
    # The configuration is the revision's as well, so that it has to be known before it is read.
    revision = parser.parse_arg("pretrained_revision", [*typed, *written])
    revision = None if revision is None or revision in NOTHING else text_value(revision)
    policy = checkpoint_config("policy.path", path, [*written, *typed], revision)
    policy.pretrained_revision = revision
    policy.pretrained_path = Path(path)
    return policy


def open_adapter(policy: PreTrainedConfig, dataset: HeldOutConfig, tolerance_s: float | None) -> AdapterOnData:
    """Load an adapter that scores, and find the episodes that its training has not seen.

    Args:
        policy: Its configuration, whose `pretrained_path` says where it lies.
        dataset: The dataset.
        tolerance_s: How far its time stamps may be off; None for what the training allowed.

    Raises:
        FileNotFoundError: If there is no such dataset.
        ValueError: If the dataset's features or rate are not the adapter's, the training saw what is asked for, or the
            policy scores nothing.
    """
    path, revision = str(policy.pretrained_path), policy.pretrained_revision
    training = training_config(Path(path), revision)
    data = dataset.completed(training)
    meta = load_metadata(data)
    check_rate(getattr(policy, "fps", None), meta.repo_id, meta.fps, "--policy.fps=null")
    loaded = load_policy(policy, str(policy.device))
    adapter, preprocess = loaded.policy.requires_grad_(False), loaded.preprocess
    given = renamed(preprocess, dataset_to_policy_features(meta.features))
    needed = {**(policy.input_features or {}), **(policy.output_features or {})}
    check_features("the adapter", needed, meta.repo_id, given)
    episodes = held_out_episodes(training, data, meta)
    if not isinstance(adapter, Adapter) or not adapter.scores:
        raise ValueError(f"{path} is a policy of type {policy.type!r}, which scores nothing: take an adapter that does")
    if tolerance_s is None:
        tolerance_s = TrainPipelineConfig.tolerance_s if training is None else training.tolerance_s
    return AdapterOnData(adapter, preprocess, training, data, meta, episodes, tolerance_s)
