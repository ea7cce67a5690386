"""A trial before the first cell: what would go wrong in each of many cells is found once, and in one line."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import gymnasium as gym

from lerobot_gloves.benchmark.adapter_options import told_options
from lerobot_gloves.benchmark.plan import Job
from lerobot_gloves.benchmark.setup import load
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.specification import NONE, name_of
from lerobot_gloves.system.errors import one_line

SEED = 0
"""Of the environment; no episode that counts has it."""


def try_all(jobs: Sequence[Job]) -> None:
    """Make every task's environment and let every method act once in it.

    Raises:
        ValueError: If an environment, agent or adapter cannot be made or used; the message says by which method.
        ImportError: If a package is missing.
    """
    tasks: dict[str, dict[str, Job]] = defaultdict(dict)
    for job in jobs:
        tasks[str(job.conditions["env"])].setdefault(_method(job), job)
    for methods in tasks.values():
        first = next(iter(methods.values()))
        with environments(first.setup.env, 1, fast_rendering=first.setup.fast_rendering) as env:
            for job in methods.values():
                with named(job):
                    try_out(job, env)


def try_out(job: Job, env: gym.vector.SyncVectorEnv) -> None:
    """Load what a job needs, and let it act, unperturbed and ungated: the gate must not keep the editor from its turn.

    Args:
        job: The job.
        env: One environment of its task.
    """
    setup = replace(job.setup, options=told_options(job.setup.options, job.cell.perturbation))
    cell = replace(job.cell, perturbation=NONE)
    if cell.gate:
        load(setup, cell)
    agent = load(setup, replace(cell, gate=False))
    agent.policy.reset()
    observation, _ = env.reset(seed=[SEED])
    try:
        agent.act(env, observation)
    except (ValueError, OSError, ImportError):
        raise
    except Exception:  # a fault that no user can mend is left to the cells, which keep its traceback
        return


@contextmanager
def named(job: Job) -> Iterator[None]:
    """Say whose fault it is."""
    try:
        yield
    except (ValueError, FileNotFoundError) as error:
        raise ValueError(f"{job.cell.title}: {one_line(error)}") from error


def _method(job: Job) -> str:
    """What jobs have in common that fail alike: all but the perturbation, unless the adapter is told it."""
    alike = {**job.conditions, "editor": name_of(job.cell.editor)}
    if not job.setup.options:
        del alike["perturbation"]
    return str(sorted(alike.items()))
