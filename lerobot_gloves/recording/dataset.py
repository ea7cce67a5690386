"""Staged episodes to a LeRobotDataset (v3) with its card, and from there to the Hub."""

import shutil
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from datasets.utils import disable_progress_bars
from huggingface_hub import HfApi
from huggingface_hub.errors import RevisionNotFoundError
from lerobot.configs import FeatureType
from lerobot.datasets import CODEBASE_VERSION, LeRobotDataset, LeRobotDatasetMetadata
from tqdm import tqdm

from lerobot_gloves.recording import staging
from lerobot_gloves.recording.agents import Agent
from lerobot_gloves.recording.demonstrations import MODE, Recordable

_PACKAGE = Path(__file__).parents[1]
CARD_FOLDERS = (_PACKAGE / "datasets_cards", _PACKAGE.parent / "datasets_cards")
"""Where the cards of the tasks lie in an installed package and in a checkout."""
CARD_HEAD = """---
license: apache-2.0
task_categories: [robotics]
tags: [LeRobot, robotics]
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""


def dataset_features(env_config: Recordable, *, video: bool) -> dict[str, dict[str, Any]]:
    """The dataset's features, under LeRobot's keys: the environment's, and each frame's mode label."""
    features: dict[str, dict[str, Any]] = {}
    for name, feature in env_config.features.items():
        key = env_config.features_map[name]
        if feature.type is FeatureType.VISUAL:
            names, dtype = ["height", "width", "channels"], "video" if video else "image"
        else:
            names, dtype = env_config.feature_names[key], "float32"
        features[key] = {"dtype": dtype, "shape": tuple(feature.shape), "names": names}
    return features | {MODE: {"dtype": "int64", "shape": (1,), "names": ["mode"]}}


def assemble(
    env_config: Recordable,
    folder: Path,
    root: Path,
    *,
    repo_id: str,
    num_episodes: int,
    video: bool,
    command: str,
    agent: Agent | None = None,
) -> None:
    """Write the staged episodes as the dataset `root`, which appears at once, whole, when all is written.

    Args:
        env_config: The task.
        folder: The staging folder; what a killed assembly left in it is thrown away.
        root: The dataset's folder; must be missing or empty.
        repo_id: The dataset's name, "user/name".
        num_episodes: How many episodes, from 0 on, to take.
        video: Images as video instead of one by one.
        command: The command that makes the dataset, for its card.
        agent: Who was recorded; None for the task's expert.
    """
    disable_progress_bars()  # of each episode's Parquet conversion
    unfinished = folder / "dataset"
    shutil.rmtree(unfinished, ignore_errors=True)
    features = dataset_features(env_config, video=video)
    dataset = LeRobotDataset.create(
        repo_id,
        fps=env_config.fps,
        root=unfinished,
        robot_type="panda",
        features=features,
        use_videos=video,
        video_backend="pyav",  # the default looks for torchcodec first, and prints a page when FFmpeg is missing
        image_writer_threads=2 if any(f["dtype"] in ("image", "video") for f in features.values()) else 0,
    )
    attempts, failures = 0, Counter[str]()
    for index in tqdm(range(num_episodes), desc="assembling", unit="episode"):
        episode = staging.load(folder, index)
        attempts += episode.attempts
        failures[episode.failure] += 1
        for row in episode.rows():
            dataset.add_frame({**row, "task": episode.task})
        dataset.save_episode()
    dataset.finalize()
    name = f"{env_config.type.removeprefix('gloves_')}.md" if agent is None else "agent.md"
    outcome = (
        f"Demonstrations that failed and were played anew: {attempts - num_episodes}."
        if agent is None
        else _agents_outcome(env_config, agent, failures)
    )
    (unfinished / "README.md").write_text(_card(name, dataset.meta, outcome, command))
    unfinished.replace(root)


def _agents_outcome(env_config: Recordable, agent: Agent, failures: Counter[str]) -> str:
    failed = ", ".join(f"{kind} {count}" for kind, count in failures.most_common() if kind)
    return (
        f"Task: `{env_config.type}`. Agent: `{agent.checkpoint}`. Perturbation: `{agent.perturbation}`.\n"
        f"Episodes that succeeded: {failures['']} of {failures.total()}{f' (failed: {failed})' if failed else ''}."
    )


def _card(name: str, meta: LeRobotDatasetMetadata, outcome: str, command: str) -> str:
    """The card of that name from `datasets_cards/`, if there is one, and what is particular to this recording."""
    card = next((folder / name for folder in CARD_FOLDERS if (folder / name).is_file()), None)
    features = "\n".join(f"| `{key}` | {ft['dtype']} | {tuple(ft['shape'])} |" for key, ft in meta.features.items())
    return f"""{card.read_text() if card else CARD_HEAD}
## This recording

{meta.total_episodes} episodes, {meta.total_frames} frames at {meta.fps} Hz.
{outcome}

| feature | type | shape |
|---|---|---|
{features}

```bash
{command}
```
"""


def push(root: Path, *, repo_id: str, private: bool | None) -> str:
    """Upload a dataset folder as it is, card included, and tag it with LeRobot's format version.

    Args:
        root: The dataset.
        repo_id: Where to, "user/name".
        private: Whether to create a private repository; None leaves that to the organisation's default.

    Returns:
        The repository's address.
    """
    hub = HfApi()
    url = hub.create_repo(repo_id, repo_type="dataset", private=private, exist_ok=True)
    hub.upload_folder(repo_id=repo_id, folder_path=root, repo_type="dataset", ignore_patterns=["images/"])
    with suppress(RevisionNotFoundError):  # the first push
        hub.delete_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
    hub.create_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
    return str(url)
