"""The matrix of a benchmark: what its file says of tasks, perturbations and methods, and the cells that this makes."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from lerobot.envs import EnvConfig

from lerobot_gloves.benchmark.cell import Cell, gated, split_gate
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.specification import NONE

MOST_SETTINGS = 12
"""How many settings of a method a search may try, the same for every method."""


@dataclass(kw_only=True)
class Setting:
    """One of the settings that a search tries; what it leaves out is the method's own.

    Attributes:
        editor: Like the method's.
        score: Like the method's.
        alpha: Like the method's.
    """

    editor: str | None = None
    score: str | None = None
    alpha: float | None = None

    def __str__(self) -> str:
        others = {"score": self.score, "alpha": self.alpha}
        told = [f"{name} {value}" for name, value in others.items() if value is not None]
        return ", ".join([*filter(None, [self.editor]), *told])


@dataclass(kw_only=True)
class Method:
    """How an agent is corrected: a column of the table.

    Attributes:
        adapter: The checkpoint that scores and edits: a folder or Hub id; None for the raw agent.
        editor: The editor's specification, such as `feeg:start=0.5`; `none` for the raw agent.
        gate: Whether chunks that look like the expert's pass unchanged.
        score: Nonconformity score and its options; None for the adapter's first, if it has any.
        alpha: The gate's significance level.
        options: Further options of the wrapper for its adapter, such as `adapter_overrides`, in which {perturbation}
            stands for the perturbation's name.
        settings: Only in a search: what to try, at most `MOST_SETTINGS`.
    """

    adapter: str | None = None
    editor: str = NONE
    gate: bool = False
    score: str | None = None
    alpha: float = 0.05
    options: dict[str, Any] = field(default_factory=dict)
    settings: list[Setting] = field(default_factory=list)

    def tried(self, label: str) -> dict[str, "Method"]:
        """The method under its label; in a search each of its settings under one of its own, in their order.

        Raises:
            ValueError: If there are too many settings, one is empty, or two are the same.
        """
        if not self.settings:
            return {label: self}
        if len(self.settings) > MOST_SETTINGS:
            raise ValueError(
                f"{label} has {len(self.settings)} settings, but a search tries at most {MOST_SETTINGS} of a method"
            )
        tried: dict[str, Method] = {}
        for setting in self.settings:
            changed = {key: value for key, value in vars(setting).items() if value is not None}
            name = f"{label} ({setting})"
            if not changed or name in tried:
                raise ValueError(f"{label} has {'an empty setting' if not changed else f'the setting {setting} twice'}")
            tried[name] = replace(self, settings=[], **changed)
        return tried


@dataclass(kw_only=True)
class Task:
    """A task of the benchmark.

    Attributes:
        env: The environment and its options.
        agent: The policy to be corrected: a checkpoint's folder or Hub id.
        perturbations: What is done to the agent: labels and specifications such as `noised:sigma=0.005`, or `none`.
        methods: How it is corrected, by label.
    """

    env: EnvConfig
    agent: str
    perturbations: dict[str, str]
    methods: dict[str, Method]


def single_task(
    env: EnvConfig, agent: str, adapter: str | None, perturbations: Sequence[str], methods: Sequence[str], **gate: Any
) -> dict[str, Task]:
    """A matrix of one task, whose perturbations and methods are called what they are.

    Args:
        env: The environment.
        agent: The policy to be corrected.
        adapter: The checkpoint that all methods use.
        perturbations: `none`, or specifications.
        methods: `none`, or editors' specifications, with `+gate` behind them to gate them.
        **gate: Score and alpha.
    """
    columns = {}
    for method in methods:
        editor, is_gated = split_gate(method)
        columns[method] = Method(adapter=adapter, editor=editor, gate=is_gated, **gate)
    return {env.type: Task(env=env, agent=agent, perturbations={p: p for p in perturbations}, methods=columns)}


def select(
    tasks: Mapping[str, Task], perturbations: Collection[str] | None, methods: Collection[str] | None
) -> dict[str, Task]:
    """The part of a matrix with these labels only; None keeps all.

    Raises:
        ValueError: If no task has such a perturbation, or such a method.
    """
    for kind, wanted in (("perturbation", perturbations), ("method", methods)):
        known = {label for task in tasks.values() for label in getattr(task, f"{kind}s")}
        for label in wanted or ():
            if label not in known:
                raise ValueError(f"no task has a {kind} {label!r}: choose from {', '.join(sorted(known))}")
    return {
        name: replace(
            task,
            perturbations=_chosen(task.perturbations, perturbations),
            methods=_chosen(task.methods, methods),
        )
        for name, task in tasks.items()
    }


def _chosen[T](everything: Mapping[str, T], labels: Collection[str] | None) -> dict[str, T]:
    return {label: value for label, value in everything.items() if labels is None or label in labels}


def cells(tasks: Mapping[str, Task], seeds: Sequence[int], **shared: Any) -> Iterator[tuple[Setup, Cell]]:
    """Every cell of a matrix with its setup.

    Seeds are outermost: a run cut short has whole tables of fewer seeds.

    Args:
        tasks: The tasks by name.
        seeds: Seeds of the policies.
        **shared: What all setups have in common: split, episodes, batch size, fast rendering.

    Raises:
        ValueError: If a setup is not valid.
    """
    columns = {
        name: [
            (column, method, _setup(task, method, shared))
            for label, described in task.methods.items()
            for column, method in described.tried(label).items()
        ]
        for name, task in tasks.items()
    }
    for seed in dict.fromkeys(seeds):
        for name, task in tasks.items():
            for (label, perturbation), (column, method, setup) in product(task.perturbations.items(), columns[name]):
                cell = Cell(perturbation, method.editor, seed, gate=method.gate, task=name)
                # What is called what it is needs no label.
                named = "" if column == gated(method.editor, method.gate) else column
                yield setup, replace(cell, perturbation_label="" if label == perturbation else label, label=named)


def _setup(task: Task, method: Method, shared: Mapping[str, Any]) -> Setup:
    return Setup(
        env=task.env,
        agent=task.agent,
        adapter=method.adapter,
        score=method.score,
        alpha=method.alpha,
        options=method.options,
        **shared,
    )
