"""Scripted drivers' rows to a table: each setting beside the same drivers alone, on the same seeds."""

from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from lerobot_gloves.report.statistics import paired_difference, success_interval
from lerobot_gloves.system.text import markdown_table

RAW = "raw"
"""The setting in which nothing corrects."""
HEADER = (
    "task",
    "driver",
    "setting",
    "success",
    "by assistance",
    "kept",
    "steps",
    "changed",
    "moved",
    "crept",
    "failures",
)
MODES = {"wrong_corridor", "wrong_button", "wrong_quadrant"}
"""Failures of an episode that did another thing than what the driver was after."""

type Row = Mapping[str, Any]


def drivers_table(rows: Sequence[Row]) -> str:
    """A Markdown table with a line for each task, driver and setting, and one for each setting over all of them.

    Args:
        rows: One an episode: `task`, `driver`, `setting`, `seed`, `began` (what its environment begins with, null if
            with something of its own), `success`, `failure`, `steps`, `commands`, `changed`, `moved` and `crept`.

    Raises:
        ValueError: If a setting was not played on the seeds of the drivers alone.
    """
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["task"], row["driver"], row["setting"]), []).append(row)
    lines = []
    for (task, driver, setting), mine in groups.items():
        lines.append([task, driver, setting, *cells(mine, groups.get((task, driver, RAW), []))])
    for setting in dict.fromkeys(row["setting"] for row in rows):
        mine = [row for row in rows if row["setting"] == setting]
        played = {(row["task"], row["driver"]) for row in mine}
        alone = [row for row in rows if row["setting"] == RAW and (row["task"], row["driver"]) in played]
        lines.append(["all", "all", setting, *cells(mine, alone)])
    return markdown_table([HEADER, *lines])


def cells(mine: Sequence[Row], alone: Sequence[Row]) -> list[str]:
    """The figures of a setting's episodes, beside the same drivers' alone."""
    by_episode = {identity(row): row for row in alone}
    if len(by_episode) != len(alone) or {identity(row) for row in mine} != by_episode.keys():
        raise ValueError(f"{mine[0]['task']}, {mine[0]['setting']}: not played on the seeds of the drivers alone")
    outcomes, clusters = [bool(row["success"]) for row in mine], [began(row) for row in mine]
    low, high = success_interval(outcomes, clusters)
    gain = "-"
    if mine[0]["setting"] != RAW:
        before = [bool(by_episode[identity(row)]["success"]) for row in mine]
        found = paired_difference(before, outcomes, clusters)
        gain = f"{100 * found.mean:+.0f} ({100 * found.low:+.0f} to {100 * found.high:+.0f})"
    commands = sum(row["commands"] for row in mine)
    failures = Counter(row["failure"] for row in mine if row["failure"])
    as_meant, decided = kept(mine)
    return [
        f"{100 * fmean(outcomes):.0f} % ({100 * low:.0f} to {100 * high:.0f})",
        gain,
        f"{100 * as_meant / decided:.0f} %" if decided else "-",
        f"{fmean(row['steps'] for row in mine):.0f}",
        f"{100 * sum(row['changed'] for row in mine) / max(1, commands):.0f} %",
        f"{100 * sum(row['moved'] * row['commands'] for row in mine) / max(1, commands):.0f} %",
        str(sum(row["crept"] for row in mine)),
        ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in sorted(failures.items())) or "none",
    ]


def identity(row: Row) -> tuple[str, str, int]:
    """Which episode of which driver it is, whatever the setting."""
    return row["task"], row["driver"], row["seed"]


def began(row: Row) -> tuple[str, Any]:
    """What an episode has in common with others: its beginning, where that is not its own."""
    return row["task"], row["seed"] if row["began"] is None else row["began"]


def kept(rows: Sequence[Row]) -> tuple[int, int]:
    """In how many episodes the driver's mode was kept, and of how many that ended by it or by another one."""
    decided = [row for row in rows if row["success"] or row["failure"] in MODES]
    return sum(bool(row["success"]) for row in decided), len(decided)
