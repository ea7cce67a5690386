"""`gloves record`: a task's scripted expert, or an agent's proposals, recorded as a LeRobotDataset."""

import os
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from httpx import HTTPError
from lerobot.configs import parser
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.envs import EnvConfig
from lerobot.utils.constants import HF_LEROBOT_HOME
from tqdm import tqdm

from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.evaluation.seeds import DEMONSTRATIONS, PROPOSALS
from lerobot_gloves.recording import agents, dataset, demonstrations, staging
from lerobot_gloves.recording.experts import check_expert
from lerobot_gloves.system.errors import one_line
from lerobot_gloves.system.locks import alone_with

MAX_BATCH_SIZE = 100
AGENT_EPISODES = 400


@dataclass
class RecordedDatasetConfig:
    """The dataset to write."""

    # Its name on the Hub, "user/name".
    repo_id: str
    # Its folder; LeRobot's folder for repo_id by default.
    root: Path | None = None
    # How many episodes; by default as many demonstrations as the paper has of the task, and 400 of an agent.
    num_episodes: int | None = None
    # Images as video instead of one by one.
    video: bool = False
    # Height and width of the images that are kept, in pixels; by default those of what is observed.
    image_size: int | None = None
    # Upload it when it is complete.
    push_to_hub: bool = False
    # Create a private repository; by default what the organisation's settings say.
    private: bool | None = None
    # What the robot is, since LeRobot merges datasets of one robot only; by default what the task says, or its type.
    robot_type: str | None = None


@dataclass
class RecordConfig:
    """Play a task's scripted expert and write its episodes as a LeRobotDataset; run again, it goes on where it stopped.

    gloves record --env.type=gloves_slalom --dataset.repo_id=USER/slalom

    With an agent instead, write what it proposes whenever it is queried, perturbed, failed episodes included: what
    gloves_align_flow learns from, merged with the expert's set by lerobot-edit-dataset --operation.type=merge.

    gloves record --env.type=gloves_slalom --agent=AGENT --perturbation=noised:sigma=0.005
    --dataset.repo_id=USER/slalom_noised
    """

    # The task.
    env: EnvConfig
    # What to write.
    dataset: RecordedDatasetConfig
    # The policy whose proposals are recorded, a checkpoint's folder or Hub id; by default the task's scripted expert.
    agent: str | None = None
    # What is done to the agent's chunks: none, or noised, laggy, slow or shift with options, such as "laggy:p=0.2".
    perturbation: str = "none"
    # Environments that an agent plays side by side, at most 100. A recording that is killed loses at most one batch.
    batch_size: int = 30
    # Seed of the first episode; episode i has seed + i. By default 30000, and 40000 for an agent.
    seed: int | None = None
    # Whether Gymnasium's MuJoCo environments, such as MetaWorld's, draw without multisampling and with coarser shadows:
    # a third of the time in software, and nearly the same pictures.
    fast_rendering: bool = False
    # Processes that record side by side.
    num_workers: int = 1

    def __post_init__(self) -> None:
        user, _, name = self.dataset.repo_id.partition("/")
        if not user or not name or "/" in name:
            raise ValueError(f"dataset.repo_id must look like user/name, not {self.dataset.repo_id!r}")
        if self.num_episodes < 1:
            raise ValueError(f"dataset.num_episodes must be at least 1, not {self.num_episodes}")
        if self.dataset.image_size is not None and self.dataset.image_size < 1:
            raise ValueError(f"dataset.image_size must be at least 1, not {self.dataset.image_size}")
        if self.num_workers < 1:
            raise ValueError(f"num_workers must be at least 1, not {self.num_workers}")
        if not 1 <= self.batch_size <= MAX_BATCH_SIZE:
            raise ValueError(f"batch_size must lie between 1 and {MAX_BATCH_SIZE}, not {self.batch_size}")
        if self.agent is None and self.perturbation != "none":
            raise ValueError(f"perturbation {self.perturbation!r} needs --agent: the expert is never perturbed")
        if self.seed is None:
            self.seed = DEMONSTRATIONS if self.agent is None else PROPOSALS
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, not {self.seed}")

    @property
    def num_episodes(self) -> int:
        """How many episodes there shall be."""
        if self.dataset.num_episodes is not None:
            return self.dataset.num_episodes
        return AGENT_EPISODES if self.agent is not None else getattr(self.env, "demonstrations", AGENT_EPISODES)

    @property
    def recorded_agent(self) -> agents.Agent | None:
        """Who is recorded; None for the task's expert."""
        if self.agent is None:
            return None
        size = min(self.batch_size, self.num_episodes)
        return agents.Agent(checkpoint=os.path.expanduser(self.agent), perturbation=self.perturbation, batch_size=size)

    @property
    def root(self) -> Path:
        """The dataset's folder."""
        return Path(self.dataset.root or HF_LEROBOT_HOME / self.dataset.repo_id).expanduser()

    @property
    def command(self) -> str:
        """What to type to record the same dataset."""
        words = ["gloves record", f"--env.type={self.env.type}"]
        for part, options in (("env", self.env), ("dataset", self.dataset)):
            for option in fields(options):
                value = getattr(options, option.name)
                default = option.default if option.default_factory is MISSING else option.default_factory()
                if option.name not in ("features", "features_map", "root") and value != default:
                    words.append(f"--{part}.{option.name}={shlex.quote(str(value))}")
        if self.agent is not None:
            words += [f"--agent={shlex.quote(self.agent)}", f"--perturbation={shlex.quote(self.perturbation)}"]
            words.append(f"--batch_size={self.batch_size}")
        if self.fast_rendering:
            words.append("--fast_rendering=true")
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
    if not folder.exists() or found != config.num_episodes:
        raise FileExistsError(
            f"{root} already holds a complete dataset of {found} episodes: choose another --dataset.root or delete it"
        )
    return True


@parser.wrap()
def record(config: RecordConfig) -> None:
    """Record, assemble and, if asked, push.

    Raises:
        BlockingIOError: If another process is making the same dataset.
    """
    told = f"another gloves record is making {config.root}: wait for it, or choose another root"
    with alone_with(config.root, told):
        _record(config)


def _record(config: RecordConfig) -> None:
    folder = staging.staging_folder(config.root)
    num_episodes, agent = config.num_episodes, config.recorded_agent
    assembled = _is_assembled(config, folder)
    env = config.env
    if agent is None:
        check_expert(env)
    played = env.gym_kwargs if agent is not None else getattr(env, "demonstration_kwargs", env.gym_kwargs)
    settings = {"env.type": env.type, "env.task": env.task, **played, "seed": config.seed}
    if config.dataset.image_size is not None:
        settings["dataset.image_size"] = config.dataset.image_size
    if config.fast_rendering:
        settings["fast_rendering"] = True
    if agent is not None:
        settings |= agent.settings()
    if agent is not None and not assembled:
        assert config.seed is not None
        # Whatever is wrong with the agent shows here, rather than in every process, and before anything is written.
        load_agent(env, agent.checkpoint, agent.perturbation, config.seed)
    staging.open_staging(folder, settings)
    if not assembled:
        present = len(staging.staged(folder) & set(range(num_episodes)))
        with tqdm(total=num_episodes, initial=present, desc="recording", unit="episode") as progress:
            for count in _episodes(config, folder):
                progress.update(count - progress.n)
        _assemble(config, folder)
    print(f"{num_episodes} {'episodes of the agent' if agent else 'demonstrations'}: {config.root}")
    if config.dataset.push_to_hub:
        print(f"pushed to {_push(config)}")
    shutil.rmtree(folder)  # last: until then, the same command finishes what is left to do


def _episodes(config: RecordConfig, folder: Path) -> Iterator[int]:
    """Stage what is missing; how many episodes there are, as they become more."""
    agent = config.recorded_agent
    how: dict[str, Any] = {
        "num_episodes": config.num_episodes,
        "seed": config.seed,
        "num_workers": config.num_workers,
        "image_size": config.dataset.image_size,
        "fast_rendering": config.fast_rendering,
    }
    if agent is None:
        return demonstrations.record(config.env, folder, **how)
    return agents.record(config.env, agent, folder, **how)


def _assemble(config: RecordConfig, folder: Path) -> None:
    """Make the dataset of what is staged.

    Raises:
        OSError: If it cannot be written.
    """
    try:
        dataset.assemble(
            config.env,
            folder,
            config.root,
            repo_id=config.dataset.repo_id,
            num_episodes=config.num_episodes,
            video=config.dataset.video,
            command=config.command,
            agent=config.recorded_agent,
            robot_type=config.dataset.robot_type,
        )
    except OSError as error:
        # On a full disk LeRobot may complain of a file that it could not write before: not of one that is asked for.
        raise OSError(f"could not write {config.root}: {one_line(error)}") from error


def _push(config: RecordConfig) -> str:
    """Upload the dataset; the repository's address.

    Raises:
        ConnectionError: If the Hub cannot be reached, or does not take it.
    """
    try:
        return dataset.push(config.root, repo_id=config.dataset.repo_id, private=config.dataset.private)
    except (OSError, HTTPError, RuntimeError, ValueError) as error:
        raise ConnectionError(
            f"{config.root} is complete, but the Hub has not got it: {one_line(error)}; if a token is missing, run "
            "hf auth login"
        ) from error


def main() -> None:
    """Entry point; `--robot` and `--teleop` are another recording's."""
    if any(argument.startswith(("--robot.", "--teleop.")) for argument in sys.argv[1:]):
        from lerobot_gloves.commands import teleoperate  # it imports every robot of LeRobot's

        return teleoperate.main()
    start()
    with one_line_errors("gloves record", "what is recorded is kept: run the command again to go on"):
        record()
