"""The search for each method's setting: all are ranked by success on validation seeds, the best is written down."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import yaml

from lerobot_gloves.benchmark.matrix import Setting, Task
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.report import summary
from lerobot_gloves.system.text import markdown_table

MOST_EPISODES = 60
"""How many episodes a search may play with each setting under each perturbation."""


@dataclass(frozen=True)
class Tried:
    """A setting and how it did.

    Attributes:
        setting: What was tried.
        success: Rate in [0, 1] by perturbation, in the task's order.
    """

    setting: Setting
    success: dict[str, float]

    @property
    def mean(self) -> float:
        """Mean over the perturbations."""
        return fmean(self.success.values())


type Ranking = dict[tuple[str, str], list[Tried]]
"""By task and method, best first."""


def check_search(tasks: Mapping[str, Task], split: str, seeds: Sequence[int], episodes: int) -> bool:
    """Whether this is a search, that is, whether a method has settings to try.

    Raises:
        ValueError: If it is one on test seeds, or with more episodes than a search may have.
    """
    if not any(method.settings for task in tasks.values() for method in task.methods.values()):
        return False
    if split != "validation":
        raise ValueError(f"a search on the {split} split: settings are chosen with --split=validation")
    if len(seeds) * episodes > MOST_EPISODES:
        raise ValueError(
            f"a search with {len(seeds)} seeds of {episodes} episodes: it may play at most {MOST_EPISODES} episodes "
            "with each setting under each perturbation"
        )
    return True


def ranking(tasks: Mapping[str, Task], rows: Sequence[Row], seeds: Sequence[int]) -> Ranking:
    """The settings of every method that has some, by the rows of `seeds`; at equal success, in the order of the file.

    Settings that lack the row of a seed under one of the perturbations are left out.
    """
    outcomes: dict[tuple[str, str, str], dict[int, list[bool]]] = defaultdict(dict)
    for row in rows:
        cell = row["cell"]
        key = cell.get("task", ""), summary.line(row), summary.column(row)
        outcomes[key][cell["seed"]] = [episode["success"] for episode in row["episodes"]]
    found: Ranking = {}
    for name, task in tasks.items():
        for label, method in task.methods.items():
            tried = []
            for setting, column in zip(method.settings, method.tried(label), strict=False):
                played = {line: outcomes[name, line, column] for line in task.perturbations}
                if all(played[line].keys() >= set(seeds) for line in played):
                    rates = {line: fmean(one for seed in seeds for one in here[seed]) for line, here in played.items()}
                    tried.append(Tried(setting, rates))
            if tried:
                found[name, label] = sorted(tried, key=lambda one: -one.mean)
    return found


def describe(found: Ranking) -> str:
    """Rankings as Markdown tables."""
    parts = []
    for (name, label), tried in found.items():
        header = ["setting", "mean", *tried[0].success]
        lines = [[str(one.setting), percent(one.mean), *map(percent, one.success.values())] for one in tried]
        parts += [f"{name}, {label}: success in % on validation seeds, best first.", markdown_table([header, *lines])]
    return "\n\n".join(parts) + "\n"


def percent(rate: float) -> str:
    """A rate in %."""
    return f"{100 * rate:.1f}"


def write_chosen(path: Path, found: Ranking, *, episodes: int) -> None:
    """Write the best setting of every method, with its figures, as the file that `chosen` of a benchmark names.

    Args:
        path: Where to.
        found: What the search found.
        episodes: Episodes behind each rate.
    """
    lines = [
        "# The best settings that gloves bench --split=validation --choose found; a benchmark takes them by `chosen`.",
        f"# Success in % of {episodes} validation episodes for each perturbation stands above each.",
        "tasks:",
    ]
    named = ""
    for (name, label), tried in found.items():
        if name != named:
            lines += [f"  {_in_one_line(name)}:", "    methods:"]
        named, best = name, tried[0]
        values = {key: value for key, value in vars(best.setting).items() if value is not None}
        each = ", ".join(f"{line} {percent(rate)}" for line, rate in best.success.items())
        lines += [
            f"      # mean {percent(best.mean)} ({each}), best of {len(tried)}",
            f"      {_in_one_line(label)}: {_in_one_line(values)}",
        ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def _in_one_line(value: Any) -> str:
    """A value as YAML."""
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000).removesuffix("...\n").strip()
