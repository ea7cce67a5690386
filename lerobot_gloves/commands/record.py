"""`gloves record`: a task's scripted expert, recorded as a LeRobotDataset."""

import shlex
import shutil
from dataclasses import dataclass, fields
from pathlib import Path

from lerobot.configs import parser
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.envs import EnvConfig
from lerobot.utils.constants import HF_LEROBOT_HOME
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging
from tqdm import tqdm

from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.recording import dataset, demonstrations, staging

RECORDING_SEEDS = 30000
"""Where the seeds of demonstrations begin; other uses of an environment stay out of 30000-39999."""


@dataclass
class RecordedDatasetConfig:
    """The dataset to write."""

    # Its name on the Hub, "user/name".
    repo_id: str
    # Its folder; LeRobot's folder for repo_id by default.
    root: Path | None = None
    # How many demonstrations.
    num_episodes: int = 400
    # Images as video instead of one by one.
    video: bool = False
    # Upload it when it is complete.
    push_to_hub: bool = False
    # Create a private repository; by default what the organisation's settings say.
    private: bool | None = None


@dataclass
class RecordConfig:
    """Play a task's scripted expert and write its episodes as a LeRobotDataset; run again, it goes on where it stopped.

    gloves record --env.type=gloves_slalom --dataset.repo_id=USER/slalom
    """

    # The task.
    env: EnvConfig
    # What to write.
    dataset: RecordedDatasetConfig
    # Seed of the first episode; episode i has seed + i.
    seed: int = RECORDING_SEEDS
    # Processes that record side by side.
    num_workers: int = 1

    def __post_init__(self) -> None:
        user, _, name = self.dataset.repo_id.partition("/")
        if not user or not name or "/" in name:
            raise ValueError(f"dataset.repo_id must look like user/name, not {self.dataset.repo_id!r}")
        if self.dataset.num_episodes < 1:
            raise ValueError(f"dataset.num_episodes must be at least 1, not {self.dataset.num_episodes}")
        if self.num_workers < 1:
            raise ValueError(f"num_workers must be at least 1, not {self.num_workers}")

    @property
    def root(self) -> Path:
        """The dataset's folder."""
        return Path(self.dataset.root or HF_LEROBOT_HOME / self.dataset.repo_id)

    @property
    def command(self) -> str:
        """What to type to record the same dataset."""
        words = ["gloves record", f"--env.type={self.env.type}"]
        for part, options in (("env", self.env), ("dataset", self.dataset)):
            for option in fields(options):
                value = getattr(options, option.name)
                if option.name not in ("features", "features_map", "root") and value != option.default:
                    words.append(f"--{part}.{option.name}={shlex.quote(str(value))}")
        return " ".join([*words, f"--seed={self.seed}"])


def _is_assembled(config: RecordConfig, folder: Path) -> bool:
    """Whether the dataset is complete and only its upload was interrupted.

    Raises:
        FileExistsError: If its folder is in use otherwise.
    """
    root = config.root
    if not root.exists() or not any(root.iterdir()):
        return False
    if not (root / "meta" / "info.json").is_file():
        raise FileExistsError(f"{root} holds other files: choose another --dataset.root")
    found = LeRobotDatasetMetadata(config.dataset.repo_id, root=root).total_episodes
    if not folder.exists() or found != config.dataset.num_episodes:
        raise FileExistsError(
            f"{root} already holds a complete dataset of {found} episodes: choose another --dataset.root or delete it"
        )
    return True


@parser.wrap()
def record(config: RecordConfig) -> None:
    """Record, assemble and, if asked, push."""
    env_config = demonstrations.check_recordable(config.env)
    folder = staging.staging_folder(config.root)
    num_episodes = config.dataset.num_episodes
    assembled = _is_assembled(config, folder)
    staging.open_staging(folder, {"env.type": env_config.type, **env_config.gym_kwargs, "seed": config.seed})
    if not assembled:
        present = len(staging.staged(folder) & set(range(num_episodes)))
        with tqdm(total=num_episodes, initial=present, desc="recording", unit="episode") as progress:
            for count in demonstrations.record(
                env_config, folder, num_episodes=num_episodes, seed=config.seed, num_workers=config.num_workers
            ):
                progress.update(count - progress.n)
        dataset.assemble(
            env_config,
            folder,
            config.root,
            repo_id=config.dataset.repo_id,
            num_episodes=num_episodes,
            video=config.dataset.video,
            command=config.command,
        )
    print(f"{num_episodes} demonstrations: {config.root}")
    if config.dataset.push_to_hub:
        print(f"pushed to {dataset.push(config.root, repo_id=config.dataset.repo_id, private=config.dataset.private)}")
    shutil.rmtree(folder)  # last: until then, the same command finishes what is left to do


def main() -> None:
    """Entry point."""
    init_logging()
    register_third_party_plugins()
    with one_line_errors("gloves record"):
        record()
