"""`gloves calibrate`: score episodes that went well with a trained adapter, so that its gate knows what is normal."""

import logging
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from huggingface_hub import HfApi
from lerobot.configs import PreTrainedConfig, parser
from lerobot.configs.default import DatasetConfig
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies import make_policy
from lerobot.utils.constants import ACTION
from lerobot.utils.feature_utils import dataset_to_policy_features
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging

from lerobot_gloves.adapter import Adapter
from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration, weights_hash
from lerobot_gloves.checkpoints.features import check_features
from lerobot_gloves.checkpoints.held_out import held_out_episodes, load_metadata
from lerobot_gloves.checkpoints.loading import without_peft
from lerobot_gloves.checkpoints.processors import load_processors
from lerobot_gloves.checkpoints.scoring import Decisions, score_dataset
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.recording.sources import expert_episodes, healthy_episodes
from lerobot_gloves.scores.score import needs_posterior
from lerobot_gloves.specification import parse_all, specification

CHUNKS_OF = ("expert", "agent")


@dataclass
class CalibrateConfig:
    """Score held-out expert episodes with a trained adapter and keep the scores beside its weights.

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=EXPERT

    Or score what an agent proposed where it succeeded, as gloves record --agent=AGENT writes it:

    gloves calibrate --policy.path=CHECKPOINT --dataset.repo_id=PROPOSALS --chunks_of=agent
    """

    # The episodes; --dataset.episodes picks some. By default, of the dataset that the adapter was trained on, those
    # that --dataset.eval_split held out of training, and of another dataset all.
    dataset: DatasetConfig
    # Whose chunks are taken of it: expert, or agent, those of an unperturbed agent's successes.
    chunks_of: str = "expert"
    # The adapter: --policy.path= a checkpoint's folder, or a Hub id with --push_to_hub=true.
    policy: PreTrainedConfig | None = None
    # Nonconformity scores to calibrate, with their options: reverse, residual, likelihood or selfnormalised for a flow,
    # for a copilot correction as well.
    scores: list[str] = field(
        default_factory=lambda: ["reverse:steps=1", "reverse:steps=2", "reverse:steps=5", "reverse:steps=10"]
    )
    # Every how many frames of an expert's episode a chunk begins; an agent's begin where it was asked.
    stride: int = 5
    # Chunks scored at once.
    batch_size: int = 64
    # Whether to add the calibration to the checkpoint's Hub repository.
    push_to_hub: bool = False

    def __post_init__(self) -> None:
        if self.chunks_of not in CHUNKS_OF:
            raise ValueError(f"unknown chunks_of {self.chunks_of!r}: choose from {', '.join(CHUNKS_OF)}")
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
    renamed = {key: name for step in preprocess.steps for key, name in getattr(step, "rename_map", {}).items()}
    given = {renamed.get(key, key): one for key, one in dataset_to_policy_features(meta.features).items()}
    needed = {**(cfg.policy.input_features or {}), **(cfg.policy.output_features or {})}
    check_features("the adapter", needed, meta.repo_id, given)
    episodes, length = held_out_episodes(cfg.policy, cfg.dataset, meta), None
    if cfg.chunks_of == "expert":
        episodes = expert_episodes(episodes, meta)
    else:
        episodes, length = healthy_episodes(episodes, meta)
    adapter = without_peft(make_policy(cfg.policy, ds_meta=meta)).eval().requires_grad_(False)
    weights = weights_hash(adapter.state_dict())
    if not isinstance(adapter, Adapter) or not adapter.scores:
        raise ValueError(f"{path} is a policy of type {cfg.policy.type!r}, which scores nothing: calibrate an adapter")
    asked = [score for text in cfg.scores for score in parse_all(text, adapter.scores, "score")]
    scores = {specification(score, adapter.scores): score for score in asked}
    decisions = _decisions(adapter, cfg.stride, length, any(map(needs_posterior, asked)))
    dataset = LeRobotDataset(
        cfg.dataset.repo_id,
        root=cfg.dataset.root,
        episodes=episodes,
        # Of actions what is scored, whatever window the adapter was trained on.
        delta_timestamps={
            **(resolve_delta_timestamps(cfg.policy, meta) or {}),
            ACTION: [index / meta.fps for index in decisions.indices],
        },
        revision=cfg.dataset.revision,
        video_backend=cfg.dataset.video_backend,
    )
    table, episode_of = score_dataset(adapter, preprocess, dataset, scores, decisions, cfg.batch_size)
    calibration = Calibration(
        scores=table,
        repo_id=cfg.dataset.repo_id,
        revision=str(cfg.dataset.revision or meta.revision),
        episodes=tuple(episodes),
        weights=weights,
        guidance=getattr(cfg.policy, "guidance", 1.0),
        episode_of=tuple(episode_of),
    )
    if Path(path).is_dir():
        calibration.save(Path(path))
        counts = len(episode_of), len(set(episode_of))
        logging.info("%d chunks of %d episodes -> %s", *counts, Path(path) / CALIBRATION_NAME)
    if cfg.push_to_hub:
        _push(calibration, cfg.policy.repo_id or path)
    return calibration


def _decisions(adapter: Any, every: int, length: int | None, told: bool) -> Decisions:
    """Which chunks are scored: the expert's, or, of so many actions, an agent's; `told` what came before.

    Raises:
        ValueError: If an agent's chunks are longer than the adapter's: what they were cut to under later observations
            is not recorded.
    """
    size, history = adapter.config.chunk_size, getattr(adapter, "history", 0) if told else 0
    if length is None:
        return Decisions(size, every, adapter.stride if history else 1, history)
    if length > size:
        raise ValueError(f"the agent proposed {length} actions at a time, but the adapter corrects {size} at most")
    return Decisions(length, length, length, history)


def _push(calibration: Calibration, repo_id: str) -> None:
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
