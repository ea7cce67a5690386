"""Whether what is held out of an align flow's training leaves it something of everybody."""

import sys
from collections import Counter
from types import FrameType
from typing import TYPE_CHECKING

from lerobot_gloves.recording.sources import SOURCES, source_of

from .configuration_gloves_align_flow import GlovesAlignFlowConfig

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata


def check_split(config: GlovesAlignFlowConfig, meta: "LeRobotDatasetMetadata") -> None:
    """Refuse a split of the data that trains on none of a source's episodes and holds all of them out.

    LeRobot holds out at least one episode of every task string: all of a source's where each has a string of its own.

    Args:
        config: The align flow's.
        meta: Of the data that it is trained on.

    Raises:
        ValueError: If there is such a source and none of it was trained before; says what to do.
    """
    counts = [_sources(one) for one in _datasets(meta)]
    if not counts:
        return
    trained, *held_out = counts
    for source in SOURCES:
        count = sum(sources[source] for sources in held_out)
        if count and not trained[source] and source not in config.sources:
            whose = "of the expert" if source == SOURCES[0] else f"of the source {source!r}"
            raise ValueError(
                f"gloves_align_flow: dataset.eval_split holds out all {count} episodes {whose}, as it does at "
                "least one of every instruction: give them one in common, by lerobot-edit-dataset "
                "--operation.type=modify_tasks, or hold out none, by --dataset.eval_split=0"
            )


def _sources(dataset: "LeRobotDataset") -> Counter[str]:
    """How many of a dataset's episodes are each source's."""
    tasks = dataset.meta.episodes["tasks"]
    episodes = range(len(tasks)) if dataset.episodes is None else dataset.episodes
    return Counter(source_of(tasks[episode][0])[0] for episode in episodes)


def _datasets(meta: "LeRobotDatasetMetadata") -> "list[LeRobotDataset]":
    """The data that is described, and what stands beside it where it is used: what was held out.

    LeRobot hands a policy the description alone, which is that of all data. So this looks who holds the data itself:
    `lerobot-train`, or whoever trains in its stead.
    """
    from lerobot.datasets import LeRobotDataset  # who trains has imported it

    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        held = [one for one in frame.f_locals.values() if isinstance(one, LeRobotDataset)]
        if any(one.meta is meta for one in held):
            return sorted(held, key=lambda one: one.meta is not meta)
        frame = frame.f_back
    return []
