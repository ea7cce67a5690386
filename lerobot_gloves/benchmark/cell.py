"""One cell of the benchmark: a task, a perturbation, a method, a seed."""

import gc
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import torch
from lerobot.envs import EnvConfig, close_envs, make_env, make_env_pre_post_processors
from lerobot.policies import get_policy_class, make_policy, make_policy_config, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from lerobot.utils.random_utils import set_seed
from torch import Tensor

from lerobot_gloves.benchmark.adapter_options import check_options, told_options
from lerobot_gloves.checkpoints.configuration import check_fits, checkpoint_config
from lerobot_gloves.evaluation.rollout import Episode, rollout
from lerobot_gloves.perturbations import PERTURBATIONS, Perturbation
from lerobot_gloves.specification import parse, specification

SEED_BANDS = {"test": 10000, "validation": 20000}
"""Where the environment seeds of a split begin."""
BAND = 100
"""How many seeds a split has room for, and how many episodes each of them."""
NONE, GATE = "none", "+gate"


@dataclass(kw_only=True, eq=False)
class Setup:
    """What a cell is played with, besides its perturbation, method and seed.

    Attributes:
        env: The task.
        agent: The policy to be corrected: a checkpoint's folder or Hub id.
        adapter: The checkpoint that scores and edits: a folder or Hub id. The method none does without.
        split: Environment seeds to use: test, or validation for choosing settings.
        episodes: Episodes of the cell, at most 100.
        batch_size: Environments that run side by side.
        score: Nonconformity score and its options; None for the adapter's first, if it has any.
        alpha: The gate's significance level.
        options: Further options of the wrapper for its adapter, such as `adapter_overrides` (see `options`).

    Raises:
        ValueError: If split, episodes or batch size is not valid.
    """

    env: EnvConfig
    agent: str
    adapter: str | None = None
    split: str = "test"
    episodes: int = 30
    batch_size: int = 30
    score: str | None = None
    alpha: float = 0.05
    options: dict[str, Any] = field(default_factory=dict)

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
        task: The task's name.
        perturbation_label: What the perturbation is called; "" for its specification.
        label: What the method is called; "" for its specification.

    Raises:
        ValueError: If the split has no room for the seed.
    """

    perturbation: str
    method: str
    seed: int
    task: str = ""
    perturbation_label: str = ""
    label: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.seed < BAND:
            raise ValueError(f"seed is {self.seed}, but must lie between 0 and {BAND - 1}")

    @property
    def line(self) -> str:
        """The perturbation's name."""
        return self.perturbation_label or self.perturbation

    @property
    def column(self) -> str:
        """The method's name."""
        return self.label or self.method

    @property
    def title(self) -> str:
        """The method's name, behind the task's if it has one."""
        return " / ".join([*filter(None, [self.task]), self.column])

    @property
    def names(self) -> list[str]:
        """Task, if it has a name, perturbation, method and seed."""
        return [*filter(None, [self.task]), self.line, self.column, f"seed {self.seed}"]

    def __str__(self) -> str:
        return " / ".join(self.names)


def resolve_perturbation(perturbation: str) -> str:
    """A perturbation with every option written out.

    Raises:
        ValueError: If it is not valid; the message lists what is.
    """
    return specification(parse(perturbation, PERTURBATION_CHOICES, "perturbation"), PERTURBATION_CHOICES)


def resolve_method(setup: Setup, method: str) -> dict[str, Any]:
    """Method, score, alpha and options with every option written out; loads no weights.

    Raises:
        ValueError: If one of them is not valid; the message lists what is.
    """
    if method == NONE:
        return {"method": NONE}
    if method == NONE + GATE:
        raise ValueError(f"method {method!r} makes no sense: the raw agent has nothing that a gate could hold back")
    if setup.adapter is None:
        raise ValueError(f"method {method!r} needs an adapter, a trained checkpoint")
    adapter: Any = get_policy_class(checkpoint_config("adapter", setup.adapter).type)
    if not hasattr(adapter, "editors"):
        raise ValueError(f"{setup.adapter} is a policy of type {adapter.name!r}, which cannot correct another one")
    gated, editors = method.endswith(GATE), {NONE: Unchanged, **adapter.editors}
    editor = specification(parse(method.removesuffix(GATE), editors, "method"), editors)
    resolved: dict[str, Any] = {"method": editor + GATE * gated, "score": None, "alpha": None}
    if adapter.scores:
        score = setup.score or next(iter(adapter.scores))
        resolved["score"] = specification(parse(score, adapter.scores, "score"), adapter.scores)
        resolved["alpha"] = setup.alpha
    elif gated or setup.score is not None:
        raise ValueError(
            f"method {method!r} with score {setup.score!r}: a policy of type {adapter.name!r} has no scores, "
            "and so no gate: leave out both"
        )
    check_options(setup.options)
    return {**resolved, "options": setup.options} if setup.options else resolved


def agent_flow(setup: Setup, method: str, perturbation: str) -> str | None:
    """The second checkpoint that a cell's adapter takes v_u from, a folder or Hub id; None if there is none.

    Raises:
        ValueError: If the adapter has no such options as the cell's method gives it.
    """
    if setup.adapter is None or method == NONE:
        return None
    overrides = told_options(setup.options, perturbation).get("adapter_overrides", ())
    return getattr(checkpoint_config("adapter", setup.adapter, overrides), "agent_flow", None)


def run(setup: Setup, cell: Cell) -> list[Episode]:
    """Play a cell's episodes, on one thread.

    Agent, adapter and environments are made anew for every cell, so that nothing of the last one is left in them. That
    takes a few hundredths of the time of a cell of Slalom.
    """
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
    """The wrapped agent of a cell, what goes before it and what behind."""
    editor = cell.method.removesuffix(GATE)
    corrected: dict[str, Any] = {"method": editor}
    if editor != NONE:
        corrected |= {
            "adapter": setup.adapter,
            "gate": cell.method.endswith(GATE),
            "alpha": setup.alpha,
            "score": setup.score,
            **told_options(setup.options, cell.perturbation),
        }
    return load_agent(setup.env, setup.agent, cell.perturbation, cell.seed, **corrected)


def load_agent(env: EnvConfig, agent: str, perturbation: str, seed: int, **corrected: Any) -> Act:
    """A wrapped agent from LeRobot's factory, what goes before it and what behind.

    Args:
        env: The task.
        agent: Folder or Hub id of the policy.
        perturbation: `none`, or a specification.
        seed: Seed of the agent, the perturbation and the editor.
        **corrected: The wrapper's options for its adapter; without any the agent is not corrected.

    Raises:
        ValueError: If the agent is made for other observations or actions.
    """
    perturbed = parse(perturbation, PERTURBATION_CHOICES, "perturbation")
    own = checkpoint_config("agent", agent)
    seeded = hasattr(own, "seed")
    config = make_policy_config(
        "gloves",
        agent=agent,
        # So that raw and adapted runs draw the same; an agent without a seed of its own has the global generators.
        agent_overrides=[f"--seed={seed}"] if seeded else [],
        perturbation=perturbed if isinstance(perturbed, Perturbation) else None,
        seed=seed,
        **corrected,
    )
    with quiet():
        policy = make_policy(config, env_cfg=env).eval()
        before, behind = make_pre_post_processors(
            config,
            str(config.pretrained_path),
            preprocessor_overrides={"device_processor": {"device": str(config.device)}},
        )
    env_before, env_behind = make_env_pre_post_processors(env_cfg=env, policy_cfg=config)
    if not env_before.steps and not env_behind.steps:  # else nobody knows what the agent gets to see
        check_fits(own, env)
    return policy, lambda seen: before(env_before(seen)), lambda action: env_behind({ACTION: behind(action)})[ACTION]


@contextmanager
def quiet() -> Iterator[None]:
    """Keep to themselves what LeRobot prints and warns of at every loading."""
    level = logging.root.manager.disable
    logging.disable(max(level, logging.WARNING))
    try:
        with open(os.devnull, "w") as nothing, redirect_stdout(nothing):
            yield
    finally:
        logging.disable(level)


@contextmanager
def environment(setup: Setup) -> Iterator[gym.vector.SyncVectorEnv]:
    """A batch of the task's environments, all in this process.

    Raises:
        ValueError: If they are several tasks, or run in processes of their own.
    """
    # The last cell's may refer to themselves, and hold what Python does not see the size of: a simulator's memory.
    gc.collect()
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
