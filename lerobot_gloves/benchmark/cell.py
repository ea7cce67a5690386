"""One cell of the benchmark: a task, a perturbation, a method, a seed."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import torch
from huggingface_hub.errors import HFValidationError
from lerobot.configs import PreTrainedConfig
from lerobot.envs import EnvConfig, close_envs, make_env, make_env_pre_post_processors
from lerobot.policies import get_policy_class, make_policy, make_policy_config, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from lerobot.utils.random_utils import set_seed
from torch import Tensor

from lerobot_gloves.benchmark.rollout import Episode, rollout
from lerobot_gloves.perturbations import PERTURBATIONS, Perturbation
from lerobot_gloves.specification import parse, specification

SEED_BANDS = {"test": 10000, "validation": 20000}
"""Where the environment seeds of a split begin."""
BAND = 100
"""How many seeds a split has room for, and how many episodes each of them."""
NONE, GATE = "none", "+gate"


# Options are explained by comments because LeRobot's parser shows those in --help.
@dataclass(kw_only=True)
class Setup:
    """What all cells of a benchmark share."""

    # The task, such as --env.type=gloves_slalom --env.obs_type=state.
    env: EnvConfig
    # The policy to be corrected: a checkpoint's folder or Hub id.
    agent: str
    # The checkpoint that scores and edits: a folder or Hub id. The method none does without.
    adapter: str | None = None
    # Environment seeds to use: test, or validation for choosing settings.
    split: str = "test"
    # Episodes of each cell, at most 100.
    episodes: int = 30
    # Environments that run side by side in a cell.
    batch_size: int = 30
    # Nonconformity score and its options.
    score: str = "reverse:steps=1"
    # The gate's significance level.
    alpha: float = 0.05

    def __post_init__(self) -> None:
        if self.split not in SEED_BANDS:
            raise ValueError(f"unknown split {self.split!r}: choose from {', '.join(SEED_BANDS)}")
        if not 1 <= self.episodes <= BAND:
            raise ValueError(f"episodes is {self.episodes}, but must lie between 1 and {BAND}")
        if self.batch_size < 1:
            raise ValueError(f"batch_size is {self.batch_size}, but must be at least 1")
        self.batch_size = min(self.batch_size, self.episodes)


@dataclass(frozen=True)
class Unchanged:
    """`none`: no perturbation, or no editor."""


PERTURBATION_CHOICES: dict[str, type] = {NONE: Unchanged, **PERTURBATIONS}


@dataclass(frozen=True)
class Cell:
    """One cell of a benchmark.

    Attributes:
        perturbation: `none`, or a specification such as `noised:sigma=0.005`.
        method: `none` for the raw agent; else an editor's specification, with `+gate` behind it to gate it.
        seed: Seed s of the policies; environment i has seed 100 s + i of the split's band.
    """

    perturbation: str
    method: str
    seed: int

    def __str__(self) -> str:
        return f"{self.perturbation} / {self.method} / seed {self.seed}"


def resolve(setup: Setup, cell: Cell) -> dict[str, Any]:
    """Perturbation, method, score and alpha of a cell with every option written out; loads no weights.

    Raises:
        ValueError: If one of them, or the seed, is not valid; the message lists what is.
    """
    if not 0 <= cell.seed < BAND:
        raise ValueError(f"seed is {cell.seed}, but must lie between 0 and {BAND - 1}")
    perturbation = parse(cell.perturbation, PERTURBATION_CHOICES, "perturbation")
    resolved = {"perturbation": specification(perturbation, PERTURBATION_CHOICES), "method": NONE}
    if cell.method == NONE:
        return resolved
    if cell.method == NONE + GATE:
        raise ValueError(
            f"method {cell.method!r} makes no sense: the raw agent has nothing that a gate could hold back"
        )
    if setup.adapter is None:
        raise ValueError(f"method {cell.method!r} needs --adapter, a trained checkpoint")
    adapter: Any = get_policy_class(checkpoint_config("adapter", setup.adapter).type)
    if not hasattr(adapter, "editors"):
        raise ValueError(f"{setup.adapter} is a policy of type {adapter.name!r}, which cannot correct another one")
    editors = {NONE: Unchanged, **adapter.editors}
    editor = specification(parse(cell.method.removesuffix(GATE), editors, "method"), editors)
    score = specification(parse(setup.score, adapter.scores, "score"), adapter.scores)
    return {**resolved, "method": editor + GATE * cell.method.endswith(GATE), "score": score, "alpha": setup.alpha}


def checkpoint_config(option: str, checkpoint: str) -> PreTrainedConfig:
    """The configuration of the policy that an option names.

    Raises:
        ValueError: If there is none.
    """
    try:
        return PreTrainedConfig.from_pretrained(checkpoint)
    except (FileNotFoundError, HFValidationError) as error:
        raise ValueError(f"--{option}={checkpoint} is no checkpoint's folder, nor one on the Hub in reach") from error


def run(setup: Setup, cell: Cell) -> list[Episode]:
    """Play a cell's episodes, on one thread."""
    torch.set_num_threads(1)
    set_seed(cell.seed)  # for agents that draw from the global generators
    first = SEED_BANDS[setup.split] + BAND * cell.seed
    policy, prepare, finish = load(setup, cell)
    device = torch.device(policy.config.device).type
    episodes: list[Episode] = []
    with environment(setup) as env, torch.autocast(device, enabled=policy.config.use_amp):
        while len(episodes) < setup.episodes:
            # The last batch is as large as the others, as in lerobot-eval; what is too many of it is dropped.
            begin = first + len(episodes)
            episodes += rollout(env, policy, prepare, finish, range(begin, begin + setup.batch_size))
    return episodes[: setup.episodes]


type Act = tuple[PreTrainedPolicy, Callable[[dict[str, Any]], dict[str, Any]], Callable[[Tensor], Tensor]]


def load(setup: Setup, cell: Cell) -> Act:
    """The wrapped agent of a cell from LeRobot's factory, what goes before it and what behind."""
    editor, perturbation = (
        cell.method.removesuffix(GATE),
        parse(cell.perturbation, PERTURBATION_CHOICES, "perturbation"),
    )
    seeded = hasattr(checkpoint_config("agent", setup.agent), "seed")
    config = make_policy_config(
        "gloves",
        agent=setup.agent,
        # So that raw and adapted runs draw the same; an agent without a seed of its own has the global generators.
        agent_overrides=[f"--seed={cell.seed}"] if seeded else [],
        adapter=None if editor == NONE else setup.adapter,
        method=editor,
        gate=cell.method.endswith(GATE),
        alpha=setup.alpha,
        score=setup.score,
        perturbation=perturbation if isinstance(perturbation, Perturbation) else None,
        seed=cell.seed,
    )
    # LeRobot prints what it loads, but standard output is for the table.
    with open(os.devnull, "w") as nothing, redirect_stdout(nothing):
        policy = make_policy(config, env_cfg=setup.env).eval()
        before, behind = make_pre_post_processors(
            config,
            str(config.pretrained_path),
            preprocessor_overrides={"device_processor": {"device": str(config.device)}},
        )
    env_before, env_behind = make_env_pre_post_processors(env_cfg=setup.env, policy_cfg=config)
    return policy, lambda seen: before(env_before(seen)), lambda action: env_behind({ACTION: behind(action)})[ACTION]


@contextmanager
def environment(setup: Setup) -> Iterator[gym.vector.SyncVectorEnv]:
    """A batch of the task's environments, all in this process.

    Raises:
        ValueError: If they are several tasks, or run in processes of their own.
    """
    envs = make_env(setup.env, n_envs=setup.batch_size, use_async_envs=False)
    try:
        found = [env for suite in envs.values() for env in suite.values()]
        if len(found) != 1 or not isinstance(found[0], gym.vector.SyncVectorEnv):
            raise ValueError(
                f"env.type {setup.env.type!r} is {len(found)} tasks, or not run in this process: choose one"
            )
        yield found[0]
    finally:
        close_envs(envs)
