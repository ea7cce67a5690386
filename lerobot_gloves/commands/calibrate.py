"""`gloves calibrate`: score held-out expert episodes with a trained adapter, so that its gate knows the expert."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from httpx import HTTPError
from huggingface_hub import HfApi
from lerobot.configs import FeatureType, PreTrainedConfig, parser
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.datasets.factory import make_train_eval_datasets, resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging
from torch import Tensor
from torch.utils.data import DataLoader, Subset
from tqdm import tqdm

from lerobot_gloves.adapter import Adapter, pad
from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration, weights_hash
from lerobot_gloves.checkpoints.processors import load_processors
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.recording.sources import SOURCES, source_of
from lerobot_gloves.specification import parse, specification
from lerobot_gloves.system.errors import one_line


@dataclass
class CalibrateConfig:
    """Score held-out expert episodes with a trained adapter and keep the scores beside its weights.

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=EXPERT
    """

    # The expert's episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on,
    # the episodes that --dataset.eval_split held out of training, and of another dataset all. An agent's are left out.
    dataset: DatasetConfig
    # The adapter: --policy.path= a checkpoint's folder, or a Hub id with --push_to_hub=true.
    policy: PreTrainedConfig | None = None
    # Nonconformity scores to calibrate, with their options.
    scores: list[str] = field(
        default_factory=lambda: ["reverse:steps=1", "reverse:steps=2", "reverse:steps=5", "reverse:steps=10"]
    )
    # Every how many frames a chunk begins.
    stride: int = 5
    # Chunks scored at once.
    batch_size: int = 64
    # Whether to add the calibration to the checkpoint's Hub repository.
    push_to_hub: bool = False

    def __post_init__(self) -> None:
        if not self.scores:
            raise ValueError("scores is empty: name at least one, such as reverse:steps=1")
        for name in ("stride", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, but must be at least 1")
        path = parser.get_path_arg("policy")
        if not path:
            raise ValueError("gloves calibrate needs --policy.path, the adapter's checkpoint")
        if not Path(path).is_dir() and not self.push_to_hub:
            raise ValueError(
                f"{path} is no folder: download the checkpoint and give its folder, "
                "or add --push_to_hub=true to calibrate it on the Hub"
            )
        self.policy = PreTrainedConfig.from_pretrained(path, cli_overrides=parser.get_cli_overrides("policy"))
        self.policy.pretrained_path = Path(path)

    @classmethod
    def __get_path_fields__(cls) -> list[str]:
        return ["policy"]


@parser.wrap()
def calibrate(cfg: CalibrateConfig) -> Calibration:
    """Run `gloves calibrate`."""
    assert cfg.policy is not None
    path = str(cfg.policy.pretrained_path)
    meta = load_metadata(cfg.dataset)
    preprocess, _ = load_processors(cfg.policy, path, cfg.policy.device)
    check_features(cfg.policy, preprocess, meta)
    episodes = expert_episodes(held_out_episodes(cfg, meta), meta)
    adapter = make_policy(cfg.policy, ds_meta=meta).eval().requires_grad_(False)
    weights = weights_hash(adapter.state_dict())
    if not isinstance(adapter, Adapter) or not adapter.scores:
        raise ValueError(f"{path} is a policy of type {cfg.policy.type!r}, which scores nothing: calibrate an adapter")
    dataset = LeRobotDataset(
        cfg.dataset.repo_id,
        root=cfg.dataset.root,
        episodes=episodes,
        # Of actions the chunk that begins here, whatever window the adapter was trained on.
        delta_timestamps={
            **(resolve_delta_timestamps(cfg.policy, meta) or {}),
            ACTION: [index / meta.fps for index in range(cfg.policy.chunk_size)],
        },
        revision=cfg.dataset.revision,
        video_backend=cfg.dataset.video_backend,
    )
    calibration = Calibration(
        scores=score_dataset(adapter, preprocess, dataset, cfg.scores, cfg.stride, cfg.batch_size),
        repo_id=cfg.dataset.repo_id,
        revision=str(cfg.dataset.revision or meta.revision),
        episodes=tuple(episodes),
        weights=weights,
        guidance=getattr(cfg.policy, "guidance", 1.0),
    )
    count = next(iter(calibration.scores.values())).shape[1]
    if Path(path).is_dir():
        calibration.save(Path(path))
        logging.info("%d chunks of %d episodes -> %s", count, len(episodes), Path(path) / CALIBRATION_NAME)
    if cfg.push_to_hub:
        _push(calibration, cfg.policy.repo_id or path)
    return calibration


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


def check_features(
    adapter: PreTrainedConfig, preprocess: PolicyProcessorPipeline, meta: LeRobotDatasetMetadata
) -> None:
    """Refuse a dataset without what the adapter was trained on; images may have another size.

    Raises:
        ValueError: Naming what is missing, and what there is.
    """
    renamed = {key: name for step in preprocess.steps for key, name in getattr(step, "rename_map", {}).items()}
    found = {renamed.get(key, key): feature for key, feature in dataset_to_policy_features(meta.features).items()}
    missing = {
        key: feature
        for key, feature in {**(adapter.input_features or {}), **(adapter.output_features or {})}.items()
        if key not in found
        or (feature.type is not FeatureType.VISUAL and tuple(feature.shape) != tuple(found[key].shape))
    }
    if missing:
        lacking, there = (
            ", ".join(f"{key} {tuple(feature.shape)}" for key, feature in sorted(features.items()))
            for features in (missing, found)
        )
        raise ValueError(
            f"{meta.repo_id} lacks {lacking}, which the adapter was trained on; it has {there or 'nothing'}"
        )


def training_config(checkpoint: Path) -> TrainPipelineConfig | None:
    """How a checkpoint was trained, None if it does not say: only `lerobot-train` writes that down."""
    if checkpoint.is_dir():
        # LeRobot would go on without the file, and complain about options that nobody gave.
        written = (checkpoint / TRAIN_CONFIG_NAME).is_file()
        return TrainPipelineConfig.from_pretrained(checkpoint) if written else None
    try:
        return TrainPipelineConfig.from_pretrained(checkpoint)
    except OSError:
        return None


def held_out_episodes(cfg: CalibrateConfig, meta: LeRobotDatasetMetadata) -> list[int]:
    """The episodes to calibrate on, none of which the training run may have seen.

    Raises:
        ValueError: If the training run saw them, or the dataset has no such episodes.
    """
    assert cfg.policy is not None
    asked, count = cfg.dataset.episodes, meta.total_episodes
    if outside := [episode for episode in asked or () if episode >= count]:
        raise ValueError(f"dataset.episodes holds {outside}, but {cfg.dataset.repo_id} has episodes 0 to {count - 1}")
    training = training_config(Path(str(cfg.policy.pretrained_path)))
    if training is None or training.dataset.repo_id != cfg.dataset.repo_id:
        if training is None:
            reason = f"no {TRAIN_CONFIG_NAME} beside the weights"
        else:
            reason = f"the adapter was trained on {training.dataset.repo_id}, not on {cfg.dataset.repo_id}"
        logging.warning("%s: cannot check that the training run saw none of these episodes", reason)
        return asked or list(range(count))
    training.dataset.root = cfg.dataset.root
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


def expert_episodes(episodes: Sequence[int], meta: LeRobotDatasetMetadata) -> list[int]:
    """Those of the episodes that no agent made (see `lerobot_gloves.recording.sources`).

    Raises:
        ValueError: If none is left.
    """
    tasks = meta.episodes["tasks"]
    experts = [episode for episode in episodes if source_of(tasks[episode][0])[0] == SOURCES[0]]
    if not experts:
        raise ValueError(f"all {len(episodes)} episodes are an agent's: calibrate on the expert's")
    return experts


@torch.no_grad()
def score_dataset(
    adapter: PreTrainedPolicy,
    preprocess: PolicyProcessorPipeline,
    dataset: LeRobotDataset,
    specifications: Sequence[str],
    stride: int,
    batch_size: int,
) -> dict[str, Tensor]:
    """Scores of the dataset's chunks by score specification, (T, n) each: row k for the first k + 1 actions.

    Chunks that run past their episode's end are left out.
    """
    scores = [parse(text, adapter.scores, "score") for text in specifications]
    length = adapter.config.chunk_size
    table: dict[str, list[Tensor]] = {specification(score, adapter.scores): [] for score in scores}
    loader = DataLoader(Subset(dataset, range(0, len(dataset), stride)), batch_size=batch_size)
    for item in tqdm(loader, desc="Scoring", unit="batch"):
        whole = ~item["action_is_pad"].any(dim=1)
        if not whole.any():
            continue
        batch = preprocess({key: value[whole] for key, value in item.items() if isinstance(value, Tensor)})
        bound, chunk = adapter.bind(batch), batch["action"]
        for name, score in zip(table, scores, strict=True):
            rows = [bound.score(pad(chunk[:, :k], length), score, length=k).cpu() for k in range(1, length + 1)]
            table[name].append(torch.stack(rows))
    if not all(table.values()):
        raise ValueError(f"no episode of the {dataset.num_episodes} is as long as a chunk, {length} actions")
    return {name: torch.cat(columns, dim=1) for name, columns in table.items()}


def _push(calibration: Calibration, repo_id: str) -> None:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        calibration.save(Path(folder))
        HfApi().upload_file(
            path_or_fileobj=Path(folder) / CALIBRATION_NAME,
            path_in_repo=CALIBRATION_NAME,
            repo_id=repo_id,
            commit_message="Calibrate the gate",
        )
    logging.info("pushed %s to %s", CALIBRATION_NAME, repo_id)


def main() -> None:
    """Entry point."""
    init_logging()
    # Where FFmpeg is missing LeRobot tells of it at length, and goes on with another decoder.
    logging.getLogger("lerobot.utils.import_utils").addFilter(lambda record: "torchcodec" not in record.getMessage())
    register_third_party_plugins()
    with one_line_errors("gloves calibrate"):
        calibrate()
