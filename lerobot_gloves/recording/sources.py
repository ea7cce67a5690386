"""Whose chunks a dataset holds, and the format of an agent's dataset.

An agent's dataset is an ordinary LeRobotDataset with exactly the features of the task's expert dataset, no column more,
so that LeRobot's own `lerobot-edit-dataset --operation.type=merge` joins it with any recording of the expert. What
differs is what its rows mean:

- It holds query moments only: each time the agent is asked for a chunk, its proposal of T actions, raw, perturbed,
  before gate and editor, becomes T adjacent rows, a block. Row j of a block holds `action` = the proposal's action j.
- All T rows of a block hold the same observation: the one at which the agent was queried.
- Blocks are whole, also when the episode ended in the middle of one, and an episode is its blocks in order, nothing
  between them: row `frame_index` of an episode is action `frame_index % T` of block `frame_index // T`.
- Every row's task string is `agent_task(source, T, succeeded)`, which says who proposed, how long its chunks are and
  whether the episode succeeded. Any other task string is the expert's. The goal stays in `observation.goal`.
- Episodes that failed are kept.

The task string, and not a column, carries the source because LeRobot hands a policy's `forward` no column other than
observations and actions, and merges only datasets whose columns agree.
"""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

SOURCES = ("expert", "none", "noised", "laggy", "slow", "shift")
"""Who made a chunk: the expert, the agent as it is, the agent under one of the paper's perturbations.

The order is the label's index. Other perturbations, and compounds, have no label, so they cannot be recorded.
"""

_AGENT_TASK = re.compile(r"agent: (?P<source>\w+), chunks of (?P<length>\d+)(?P<succeeded>, succeeded)?")


def agent_task(source: str, length: int, succeeded: bool = False) -> str:
    """The task string of an agent's rows.

    Args:
        source: One of `SOURCES` but the expert.
        length: T, the actions in each of its proposals.
        succeeded: Whether the episode did. Those of before this was noted are not known to have.

    Raises:
        ValueError: If there is no such source, or a proposal would hold no action.
    """
    if source not in SOURCES[1:]:
        raise ValueError(f"unknown source {source!r} of an agent's chunks: choose from {', '.join(SOURCES[1:])}")
    if length < 1:
        raise ValueError(f"an agent's proposals have {length} actions, but must have at least 1")
    return f"agent: {source}, chunks of {length}{', succeeded' if succeeded else ''}"


def source_of(task: str) -> tuple[str, int]:
    """Who made the rows with this task string, and in proposals of how many actions.

    Returns:
        One of `SOURCES`, and T; 1 for the expert, each of whose rows begins a chunk of its own.

    Raises:
        ValueError: If the string is an agent's, but of no known source.
    """
    match = _AGENT_TASK.fullmatch(task)
    if match is None:
        return SOURCES[0], 1
    source, length = match["source"], int(match["length"])
    agent_task(source, length)
    return source, length


def expert_episodes(episodes: Sequence[int], meta: "LeRobotDatasetMetadata") -> list[int]:
    """Those of a dataset's episodes that no agent made.

    Raises:
        ValueError: If none is left.
    """
    tasks = meta.episodes["tasks"]
    experts = [episode for episode in episodes if source_of(tasks[episode][0])[0] == SOURCES[0]]
    if not experts:
        raise ValueError(f"all {len(episodes)} episodes are an agent's: calibrate on the expert's")
    return experts


def healthy_episodes(episodes: Sequence[int], meta: "LeRobotDatasetMetadata") -> tuple[list[int], int]:
    """Those of a dataset's episodes in which an unperturbed agent succeeded, and T, the actions of its proposals.

    Raises:
        ValueError: If there are none, or their proposals are of several lengths.
    """
    found = [_AGENT_TASK.fullmatch(tasks[0]) for tasks in meta.episodes["tasks"]]
    healthy = {
        episode: int(match["length"])
        for episode in episodes
        if (match := found[episode]) and match["source"] == SOURCES[1] and match["succeeded"]
    }
    lengths = sorted(set(healthy.values()))
    if len(lengths) != 1:
        what = (
            f"proposals of {' and '.join(map(str, lengths))} actions" if lengths else "no success of an agent as it is"
        )
        raise ValueError(
            f"the {len(episodes)} episodes of {meta.repo_id} hold {what}: "
            "record one by gloves record --agent=<checkpoint>"
        )
    return list(healthy), lengths[0]
