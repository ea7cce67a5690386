"""Staged episodes to a LeRobotDataset (v3) with its card, and from there to the Hub."""

import shutil
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from datasets.utils import disable_progress_bars
from huggingface_hub import HfApi
from huggingface_hub.errors import RevisionNotFoundError
from lerobot.datasets import CODEBASE_VERSION, LeRobotDataset, LeRobotDatasetMetadata
from lerobot.envs import EnvConfig
from lerobot.utils.constants import OBS_IMAGE
from tqdm import tqdm

from lerobot_gloves.recording import staging
from lerobot_gloves.recording.agents import Agent
from lerobot_gloves.recording.demonstrations import MODE

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


def dataset_features(env_config: EnvConfig, row: Mapping[str, np.ndarray], *, video: bool) -> dict[str, dict[str, Any]]:
    """The features of a dataset with such rows, under LeRobot's keys; those that the task lists go first."""
    names = getattr(env_config, "feature_names", {})
    listed = [env_config.features_map.get(name) for name in env_config.features]
    features: dict[str, dict[str, Any]] = {}
    for key in dict.fromkeys([*(key for key in listed if key in row), *row]):
        if key == MODE:
            features[key] = {"dtype": "int64", "names": ["mode"]}
        elif key.startswith(OBS_IMAGE):
            features[key] = {"dtype": "video" if video else "image", "names": ["height", "width", "channels"]}
        else:
            features[key] = {"dtype": "float32", "names": names.get(key)}
        features[key]["shape"] = row[key].shape
    return features


def assemble(
    env_config: EnvConfig,
    folder: Path,
    root: Path,
    *,
    repo_id: str,
    num_episodes: int,
    video: bool,
    command: str,
    agent: Agent | None = None,
    person: str | None = None,
    robot_type: str | None = None,
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
        agent: Who was recorded; None for the task's expert, or a person.
        person: What the card says of the study in which a person was recorded.
        robot_type: What the robot is; None for what the task says of it, by its `robot_type` or else by its name.
    """
    disable_progress_bars()  # of each episode's Parquet conversion
    unfinished = folder / "dataset"
    shutil.rmtree(unfinished, ignore_errors=True)
    features = dataset_features(env_config, next(staging.load(folder, 0).rows()), video=video)
    dataset = LeRobotDataset.create(
        repo_id,
        fps=env_config.fps,
        root=unfinished,
        robot_type=robot_type or getattr(env_config, "robot_type", env_config.type),
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
    if person is not None:
        name, outcome = "study.md", person
    elif agent is not None:
        name, outcome = "agent.md", _agents_outcome(env_config, agent, failures)
    else:
        name = f"{env_config.type.removeprefix('gloves_')}.md"
        outcome = f"Demonstrations that failed and were played anew: {attempts - num_episodes}."
    (unfinished / "README.md").write_text(_card(name, dataset.meta, outcome, command))
    unfinished.replace(root)


def _agents_outcome(env_config: EnvConfig, agent: Agent, failures: Counter[str]) -> str:
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
