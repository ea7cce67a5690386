"""Scores of a dataset's chunks by an adapter: what a calibration holds."""

from collections.abc import Sequence

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor
from torch.utils.data import DataLoader, Subset
from tqdm import tqdm

from lerobot_gloves.adapter import pad
from lerobot_gloves.checkpoints.processors import Pipeline
from lerobot_gloves.specification import parse, specification


@torch.no_grad()
def score_dataset(
    adapter: PreTrainedPolicy,
    preprocess: Pipeline,
    dataset: LeRobotDataset,
    specifications: Sequence[str],
    stride: int,
    batch_size: int,
) -> dict[str, Tensor]:
    """Scores of the dataset's chunks by score specification, (T, n) each: row k for the first k + 1 actions.

    Chunks that run past their episode's end are left out.
    """
    scores = [parse(text, adapter.scores, "score") for text in specifications]
    length = adapter.config.chunk_size
    table: dict[str, list[Tensor]] = {specification(score, adapter.scores): [] for score in scores}
    loader = DataLoader(Subset(dataset, range(0, len(dataset), stride)), batch_size=batch_size)
    for item in tqdm(loader, desc="Scoring", unit="batch"):
        whole = ~item["action_is_pad"].any(dim=1)
        if not whole.any():
            continue
        batch = preprocess({key: value[whole] for key, value in item.items() if isinstance(value, Tensor)})
        bound, chunk = adapter.bind(batch), batch["action"]
        for name, score in zip(table, scores, strict=True):
            rows = [bound.score(pad(chunk[:, :k], length), score, length=k).cpu() for k in range(1, length + 1)]
            table[name].append(torch.stack(rows))
    if not all(table.values()):
        raise ValueError(f"no episode of the {dataset.num_episodes} is as long as a chunk, {length} actions")
    return {name: torch.cat(columns, dim=1) for name, columns in table.items()}
