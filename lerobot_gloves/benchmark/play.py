"""A cell played in this process."""

import platform
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import torch
from lerobot.utils.random_utils import set_seed

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.plan import Job
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.benchmark.setup import Setup, agent_flow, load
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.episode import Episode
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.evaluation.seeds import environment_seeds, policy_seed
from lerobot_gloves.system.errors import one_line

PACKAGES = ("lerobot_policy_gloves", "lerobot", "torch", "numpy", "gymnasium", "mujoco", "robosuite", "diffusers")


@dataclass(frozen=True)
class Failed:
    """A cell that could not be played.

    Attributes:
        reason: Why, in one line.
        details: Why, in as many as it takes.
    """

    reason: str
    details: str


def play(job: Job) -> Row | Failed:
    """Play a cell, after a look whether its checkpoints are the planned ones."""
    began = time.perf_counter()
    try:
        second = agent_flow(job.setup, job.cell)
        for name, checkpoint in (("agent", job.setup.agent), ("adapter", job.setup.adapter), ("agent_flow", second)):
            if checkpoint and job.conditions.get(name, (found := checkpoint_hash(checkpoint))) != found:
                raise ValueError(f"the {name} {checkpoint} is another one here than where the run began")
        episodes = run(job.setup, job.cell)
    except Exception as error:
        return Failed(f"{type(error).__name__}: {one_line(error)}", traceback.format_exc())
    return make_row(job, seconds=time.perf_counter() - began, episodes=episodes)


def run(setup: Setup, cell: Cell) -> list[Episode]:
    """A cell's episodes, on one thread.

    Agent, adapter and environments are made anew for every cell, so that nothing of the last one is left in them. That
    takes a few hundredths of the time of a cell of Slalom.
    """
    torch.set_num_threads(1)
    set_seed(policy_seed(setup.split, cell.seed))  # for agents that draw from the global generators
    seeds = environment_seeds(setup.split, cell.seed, setup.episodes)
    agent = load(setup, cell)
    episodes: list[Episode] = []
    with environments(setup.env, setup.batch_size, fast_rendering=setup.fast_rendering) as env, agent.autocast:
        while len(episodes) < setup.episodes:
            # The last batch is as large as the others, as in lerobot-eval; what is too many of it is dropped.
            begin = seeds.start + len(episodes)
            episodes += rollout(env, agent, range(begin, begin + setup.batch_size))
    return episodes[: setup.episodes]


def make_row(job: Job, *, seconds: float, episodes: Sequence[Episode]) -> Row:
    """The row of a cell that has just been played on this machine."""
    return Row(
        cell=job.cell,
        conditions=job.conditions,
        episodes=tuple(episodes),
        checkpoints={"agent": job.setup.agent, "adapter": job.setup.adapter},
        versions=versions(),
        seconds=round(seconds, 3),
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that an episode depends on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
