"""`gloves calibrate`: score held-out expert episodes with a trained adapter, so that its gate knows the expert."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from huggingface_hub import HfApi
from lerobot.configs import PreTrainedConfig, parser
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.datasets.factory import make_train_eval_datasets, resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging
from torch import Tensor
from torch.utils.data import DataLoader, Subset
from tqdm import tqdm

from lerobot_gloves.adapter import Adapter, pad
from lerobot_gloves.calibration import CALIBRATION_NAME, Calibration, weights_hash
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.sources import SOURCES, source_of
from lerobot_gloves.specification import parse, specification


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
    meta = LeRobotDatasetMetadata(cfg.dataset.repo_id, root=cfg.dataset.root, revision=cfg.dataset.revision)
    episodes = expert_episodes(held_out_episodes(cfg, meta), meta)
    adapter = make_policy(cfg.policy, ds_meta=meta).eval().requires_grad_(False)
    weights = weights_hash(adapter.state_dict())
    preprocess, _ = make_pre_post_processors(
        cfg.policy, path, preprocessor_overrides={"device_processor": {"device": cfg.policy.device}}
    )
    if not isinstance(adapter, Adapter):
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
    )
    count = next(iter(calibration.scores.values())).shape[1]
    if Path(path).is_dir():
        calibration.save(Path(path))
        logging.info("%d chunks of %d episodes -> %s", count, len(episodes), Path(path) / CALIBRATION_NAME)
    if cfg.push_to_hub:
        _push(calibration, cfg.policy.repo_id or path)
    return calibration


def held_out_episodes(cfg: CalibrateConfig, meta: LeRobotDatasetMetadata) -> list[int]:
    """The episodes to calibrate on, none of which the training run may have seen.

    Raises:
        ValueError: If the training run saw them.
    """
    assert cfg.policy is not None
    asked = cfg.dataset.episodes
    try:
        training = TrainPipelineConfig.from_pretrained(cfg.policy.pretrained_path)
    except (FileNotFoundError, OSError):
        logging.warning("no %s beside the weights: cannot check what the training run saw", TRAIN_CONFIG_NAME)
        return asked or list(range(meta.total_episodes))
    if training.dataset.repo_id != cfg.dataset.repo_id:
        return asked or list(range(meta.total_episodes))
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
    """Those of the episodes that no agent made (see `lerobot_gloves.sources`).

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
    register_third_party_plugins()
    with one_line_errors("gloves calibrate"):
        calibrate()
