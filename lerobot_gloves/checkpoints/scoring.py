"""Scores of a dataset's chunks by an adapter: what a calibration holds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor
from torch.utils.data import DataLoader
from tqdm import tqdm

from lerobot_gloves.adapter import pad
from lerobot_gloves.checkpoints.processors import Pipeline
from lerobot_gloves.checkpoints.statistics import Constants, action_units
from lerobot_gloves.faults import Fault


@dataclass(frozen=True)
class Decisions:
    """Which chunks of an episode are scored, and what was proposed before each.

    Attributes:
        lengths: How many leading actions of a chunk count, ascending, one row of scores each; the last are all of it,
            at most the adapter's T.
        every: Frames between the beginnings of two chunks; the first begins with the episode.
        stride: Frames between a chunk and the one proposed before it.
        history: How many of those the adapter is told, as far as the episode goes back; 0 for none.
    """

    lengths: Sequence[int]
    every: int
    stride: int = 1
    history: int = 0

    @property
    def length(self) -> int:
        """Actions of a chunk."""
        return self.lengths[-1]

    @property
    def indices(self) -> list[int]:
        """Actions that a frame is to be loaded with, relative to it."""
        return list(range(-self.history * self.stride, self.length))

    def told(self, frame: Tensor) -> Tensor:
        """How many of the last proposals a chunk is told that begins at frames (n,) of its episode."""
        return (frame // self.stride).clamp(max=self.history)

    def chunks(self, action: Tensor, told: int) -> Tensor:
        """The last proposals and the chunk itself, (B, told + 1, length, A), of what `indices` loads, (B, N, A)."""
        begins = [(self.history - back) * self.stride for back in range(told, -1, -1)]
        return torch.stack([action[:, begin : begin + self.length] for begin in begins], dim=1)


@torch.no_grad()
def score_dataset(
    adapter: PreTrainedPolicy,
    preprocess: Pipeline,
    dataset: LeRobotDataset,
    scores: Mapping[str, Any],
    decisions: Decisions,
    batch_size: int,
    stands_for: Fault | None = None,
) -> tuple[dict[str, Tensor], list[int]]:
    """Scores of the dataset's chunks, (L, n) by score, a row for each of `decisions.lengths`; the episode of each.

    Chunks that run past their episode's end are left out. Of the last proposals as many actions are told as of the
    chunk count: an agent with shorter chunks made shorter ones before as well.

    Args:
        adapter: What scores.
        preprocess: Its preprocessor.
        dataset: The dataset, which loads `decisions.indices` of its actions.
        scores: The scores, by the name that they shall have.
        decisions: Which chunks to score.
        batch_size: Chunks scored at once.
        stands_for: What makes a proposal of a chunk, each of those that were proposed before alike; None for nothing.

    Raises:
        ValueError: If no episode is as long as a chunk, or a score is not a number.
    """
    constants, generator = Constants(preprocess), torch.Generator().manual_seed(0)
    table: dict[str, list[Tensor]] = {name: [] for name in scores}
    episode_of: list[int] = []
    batches = alike(dataset, decisions, batch_size)
    for item in tqdm(DataLoader(dataset, batch_sampler=batches), desc="Scoring", unit="batch"):
        whole = ~item["action_is_pad"][:, -decisions.length :].any(dim=1)
        if not whole.any():
            continue
        rows = {key: value[whole] for key, value in item.items() if isinstance(value, Tensor)}
        told = int(decisions.told(rows["frame_index"])[0])
        held = constants.hold(rows | {ACTION: decisions.chunks(rows[ACTION], told)})
        batch = preprocess(held)
        if stands_for is not None:
            each = batch[ACTION].flatten(0, 1)[:, None]
            units = action_units(preprocess, constants, held)
            batch[ACTION] = stands_for(each, units, generator).view_as(batch[ACTION])
        found = score_lengths(adapter, batch, list(scores.values()), decisions)
        for name, columns in zip(table, found.unbind(dim=1), strict=True):
            table[name].append(columns)
        episode_of += rows["episode_index"].tolist()
    if not episode_of:
        raise ValueError(f"no episode of the {dataset.num_episodes} is as long as a chunk, {decisions.length} actions")
    scored = {name: torch.cat(columns, dim=1) for name, columns in table.items()}
    for name, values in scored.items():
        if (bad := values.isnan().any(dim=0)).any():
            raise ValueError(
                f"{int(bad.sum())} of {len(bad)} chunks score NaN by {name}, the first of episode "
                f"{episode_of[int(bad.int().argmax())]}: the adapter's weights or the data hold what is no number"
            )
        if values.isposinf().all(dim=1).any():
            raise ValueError(f"all {values.shape[1]} chunks score infinite by {name}: take another score")
    return scored, episode_of


def score_lengths(adapter: Any, batch: Mapping[str, Tensor], scores: list[Any], decisions: Decisions) -> Tensor:
    """Scores (L, m, B) by m scores of a batch whose actions are `Decisions.chunks`, normalised."""
    *before, chunk = batch[ACTION].unbind(dim=1)
    size, bound, found = adapter.config.chunk_size, None, []
    for k in decisions.lengths:
        if decisions.history:
            history = torch.stack([pad(past[:, :k], size) for past in before], dim=1) if before else None
            bound = adapter.bind(batch, history)
        elif bound is None:
            bound = adapter.bind(batch)
        found.append(torch.stack([bound.score(pad(chunk[:, :k], size), score, length=k).cpu() for score in scores]))
    return torch.stack(found)


def default_lengths(length: int) -> tuple[int, ...]:
    """For what lengths chunks are scored if nobody says: all, or of long chunks the whole, halves, quarters and ones.

    Every length takes a pass of its own, since the padding behind it is another. Up to here all of them together cost
    less than four of a chunk of 100.
    """
    if length <= 20:
        return tuple(range(1, length + 1))
    return 1, length // 4, length // 2, length


def alike(dataset: LeRobotDataset, decisions: Decisions, batch_size: int) -> list[list[int]]:
    """The rows at which chunks begin, in batches whose chunks are told equally many of the last proposals."""
    frame = torch.tensor(dataset.hf_dataset.data.column("frame_index").to_numpy())
    told = torch.where(frame % decisions.every == 0, decisions.told(frame), -1)
    groups = ((told == count).nonzero()[:, 0] for count in range(decisions.history + 1))
    return [batch.tolist() for group in groups for batch in group.split(batch_size) if len(batch)]
