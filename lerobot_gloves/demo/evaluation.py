"""The demo's runs of `lerobot-eval`, and what they leave on disk."""

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from lerobot_gloves.perturbations import CHOICES, parse_perturbation
from lerobot_gloves.system.processes import Command, console_script

CHUNK_LOG = "chunks.jsonl"
ROLLED_OUT = re.compile(r"Running rollout.*?(?P<done>\d+)/(?P<total>\d+) ")


@dataclass(frozen=True, eq=False)
class Run:
    """The episodes behind a row of the demo's table.

    Attributes:
        name: Its folder.
        label: What the user reads.
        options: Options of the wrapper.
        recorded: Whether actions and observations of every episode are kept, for the picture and the video.
    """

    name: str
    label: str
    options: Sequence[str] = ()
    recorded: bool = False


@dataclass(frozen=True)
class Comparison:
    """What all runs share.

    Attributes:
        agent: Folder of the agent.
        perturbation: What is done to it, such as `noised:sigma=0.005`.
        episodes: How many, all side by side.
        seed: Seed of the first environment; environment i has seed + i.
        folder: Where the runs write, each in a folder of its own.
    """

    agent: Path
    perturbation: str
    episodes: int
    seed: int
    folder: Path


@dataclass
class PlayedRun:
    """What a run left.

    Attributes:
        run: What was played.
        successes: Per episode.
        actions: Per recorded episode, executed actions (L, 2), metres.
        set_points_and_tips: Per recorded episode, what was observed before each of them, (L, 4), metres.
        chunks: Lines of the wrapper's log; none for the raw agent.
    """

    run: Run
    successes: list[bool]
    actions: list[np.ndarray]
    set_points_and_tips: list[np.ndarray]
    chunks: list[dict] = field(default_factory=list)

    @property
    def intervention_rate(self) -> float | None:
        """Share of chunks that were edited."""
        return float(np.mean([chunk["edited"] for chunk in self.chunks])) if self.chunks else None

    @property
    def distance(self) -> float | None:
        """Mean distance of executed from proposed actions over all chunks, in the adapter's normalised units."""
        return float(np.mean([chunk["distance"] for chunk in self.chunks])) if self.chunks else None


def evaluation(comparison: Comparison, run: Run) -> Command:
    """The command that plays a run, all episodes in one batch. What an earlier one left in its folder is removed."""
    folder = comparison.folder / run.name
    shutil.rmtree(folder, ignore_errors=True)
    # Unless it records, lerobot-eval draws ten videos: small ones, since nobody looks at them.
    kept = "--eval.recording=true" if run.recorded else "--env.image_size=64"
    words = [
        console_script("lerobot-eval"),
        f"--policy.path={comparison.agent}",
        "--policy.wrap=gloves",
        "--policy.device=cpu",
        *perturbation_options(comparison.perturbation),
        *run.options,
        f"--policy.log={folder / CHUNK_LOG}",
        "--env.type=gloves_slalom",
        "--env.obs_type=state",
        f"--eval.n_episodes={comparison.episodes}",
        f"--eval.batch_size={comparison.episodes}",
        "--eval.use_async_envs=false",
        kept,
        f"--seed={comparison.seed}",
        f"--output_dir={folder}",
    ]
    return Command(run.label, words, folder.with_suffix(".log"), ROLLED_OUT)


def perturbation_options(specification: str) -> list[str]:
    """Options of the wrapper for a perturbation, such as `noised:sigma=0.005`; none for `none`.

    Raises:
        ValueError: If it is not one; the message lists the valid ones.
    """
    perturbation = parse_perturbation(specification)
    if perturbation is None:
        return []
    name = next(name for name, choice in CHOICES.items() if choice is type(perturbation))
    values = [f"--policy.perturbation.{one.name}={getattr(perturbation, one.name)}" for one in fields(perturbation)]
    return [f"--policy.perturbation.type={name}", *values]


def read(comparison: Comparison, run: Run) -> PlayedRun:
    """Read what a finished run left."""
    folder = comparison.folder / run.name
    info = json.loads((folder / "eval_info.json").read_text())
    (task,) = info["per_task"]
    successes = [bool(success) for success in task["metrics"]["successes"]]
    actions, observed = [], []
    for episode in range(comparison.episodes) if run.recorded else ():
        # LeRobot numbers the datasets of a batch by environment, and writes no number for a batch of one.
        part = f"env_{episode}" if comparison.episodes > 1 else ""
        (file,) = (folder / "recordings").glob(f"*/{part}/data/*/*.parquet")
        table = pq.read_table(file, columns=["action", "agent_pos"])
        actions.append(np.array(table["action"].to_pylist(), dtype=np.float32))
        observed.append(np.array(table["agent_pos"].to_pylist(), dtype=np.float32))
    log = folder / CHUNK_LOG
    chunks = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    return PlayedRun(run, successes, actions, observed, chunks)
