"""A dataset of an agent's proposals, as `lerobot_gloves.recording.sources` says that it is."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lerobot.datasets import LeRobotDataset

from lerobot_gloves.recording.sources import agent_task
from tests.builders import features


def write_agent_dataset(
    root: Path, proposals: np.ndarray, source: str = "noised", succeeded: Sequence[bool] = ()
) -> LeRobotDataset:
    """Proposals (E, n, T, A) of E episodes of n queries, in the format of `lerobot_gloves.recording.sources`.

    The entries of a row's observations are the number of its query. `succeeded` says which episodes did; by default
    none.
    """
    inputs, outputs = features()
    shapes = {**inputs, **outputs}
    names = {key: [f"{key.split('.')[-1]}_{i}" for i in range(feature.shape[0])] for key, feature in shapes.items()}
    columns = {key: {"dtype": "float32", "shape": shapes[key].shape, "names": names[key]} for key in shapes}
    dataset = LeRobotDataset.create("me/agent", fps=20, root=root, features=columns, use_videos=False)
    for episode, success in zip(proposals, succeeded or [False] * len(proposals), strict=True):
        for query, proposal in enumerate(episode):
            for action in proposal:
                row = {key: np.full(feature.shape, query, np.float32) for key, feature in inputs.items()}
                task = agent_task(source, proposals.shape[2], success)
                dataset.add_frame({**row, "action": action.astype(np.float32), "task": task})
        dataset.save_episode()
    dataset.finalize()
    return dataset
