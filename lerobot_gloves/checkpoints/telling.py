"""What an adapter's scores tell apart: an expert's chunks, held out of its training, and the same chunks gone wrong."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor
from torch.utils.data import DataLoader, Subset
from tqdm import tqdm

from lerobot_gloves.adapter import pad
from lerobot_gloves.checkpoints.on_data import AdapterOnData
from lerobot_gloves.checkpoints.scoring import Decisions, alike
from lerobot_gloves.checkpoints.statistics import Constants
from lerobot_gloves.conformal import auroc
from lerobot_gloves.scores.score import needs_posterior

KINDS = ("noised", "scaled", "shifted", "replayed", "another moment")
CLEAN = "clean"
RESAMPLES = 500
KNOWS = 0.6
"""An adapter that knows what is to be done where has at least this area between a context's own chunk and another's."""


@dataclass(frozen=True)
class Chunks:
    """Scores of N of the expert's chunks, as they are and gone wrong.

    Attributes:
        scores: By score and kind (`CLEAN` and `KINDS`), (N,) each. An episode's first chunk cannot be replayed, so
            there that is NaN.
        episode: Which episode each is of, (N,).
    """

    scores: Mapping[str, Mapping[str, Tensor]]
    episode: Tensor

    def area(self, score: str, kind: str) -> tuple[float, float, float]:
        """Area under the ROC curve of a score between clean chunks and those of a kind, and its 95 % interval.

        The interval is the bootstrap's over episodes, which chunks of one episode are too much alike for a
        resampling of chunks to do.
        """
        clean, wrong = self.scores[score][CLEAN], self.scores[score][kind]
        members = [(self.episode == one).nonzero()[:, 0] for one in self.episode.unique()]
        generator = torch.Generator().manual_seed(0)
        found = []
        for _ in range(RESAMPLES if len(members) > 1 else 0):
            drawn = torch.randint(len(members), (len(members),), generator=generator)
            rows = torch.cat([members[one] for one in drawn.tolist()])
            found.append(auroc(clean[rows], wrong[rows]))
        low, high = torch.tensor(found).quantile(torch.tensor([0.025, 0.975])).tolist() if found else (0.0, 1.0)
        return auroc(clean, wrong), low, high

    def seen(self, score: str, kind: str, alpha: float) -> float:
        """The share of the chunks of a kind above all but at most a share alpha, below 1, of the clean ones."""
        clean, wrong = self.scores[score][CLEAN], self.scores[score][kind]
        least = clean.sort().values[math.ceil((1 - alpha) * len(clean)) - 1]
        return (wrong[~wrong.isnan()] > least).double().mean().item()


def verdict(chunks: Chunks) -> tuple[bool, str]:
    """Whether some score tells a chunk of another moment, and what there is to say of it in one line."""
    areas = {name: chunks.area(name, "another moment") for name in chunks.scores}
    best = max(areas, key=lambda name: areas[name][1])
    area, low, _ = areas[best]
    found = f"the area between a context's own chunk and another's is {area:.2f} by {best}, at least {low:.2f}"
    if low >= KNOWS:
        return True, f"usable: {found}"
    return False, (
        f"not usable: {found}, where {KNOWS} is needed: train longer, on more demonstrations, or on those of this task"
    )


def went_wrong(
    chunk: Tensor, before: Tensor, other: Tensor, spread: Tensor, generator: torch.Generator
) -> dict[str, Tensor]:
    """Raw chunks (B, T, A) of each of `KINDS`.

    Args:
        chunk: The expert's.
        before: What the expert did the chunk before.
        other: What it did at another moment.
        spread: The data's standard deviations, (A,).
        generator: Source of noise and of the entry that is shifted.
    """
    noise = torch.randn(chunk.shape, generator=generator)
    entry = torch.randint(chunk.shape[-1], (len(chunk), 1, 1), generator=generator)
    shifted = torch.zeros_like(chunk).scatter(2, entry.expand(-1, chunk.shape[1], 1), 1.0)
    return {
        "noised": chunk + 0.5 * spread * noise,
        "scaled": 0.5 * chunk,
        "shifted": chunk + spread * shifted,
        "replayed": before,
        "another moment": other,
    }


@torch.no_grad()
def tell(
    on_data: AdapterOnData, scores: Mapping[str, Any], most: int, batch_size: int, kinds: Sequence[str] = KINDS
) -> Chunks:
    """Score the chunks of held-out episodes, as they are and gone wrong.

    Args:
        on_data: Adapter and data.
        scores: The scores by name.
        most: About how many chunks; as many frames lie between two as that asks for, of every episode alike.
        batch_size: Chunks scored at once.
        kinds: How they go wrong, some of `KINDS`.

    Raises:
        ValueError: If no episode is as long as a chunk.
    """
    adapter, preprocess = on_data.adapter, on_data.preprocess
    size = adapter.config.chunk_size
    history = getattr(adapter, "history", 0) if any(map(needs_posterior, scores.values())) else 0
    stride = adapter.stride if history else 1
    frames = sum(int(on_data.meta.episodes["length"][episode]) for episode in on_data.episodes)
    decisions = Decisions((size,), max(1, frames // most), stride, history)
    dataset = on_data.frames(on_data.episodes, decisions.indices)
    columns = dataset.hf_dataset.with_format("torch", columns=[ACTION, "episode_index", "frame_index"])[:]
    action, episode, frame = (columns[name] for name in (ACTION, "episode_index", "frame_index"))
    action = action.float()
    spread = torch.as_tensor(on_data.meta.stats[ACTION]["std"]).float()
    starts = torch.tensor([row for row in range(len(action) - size + 1) if episode[row] == episode[row + size - 1]])
    if not len(starts):
        raise ValueError(f"no episode is as long as a chunk of the adapter, {size} actions")
    generator, constants = torch.Generator().manual_seed(0), Constants(preprocess)
    found: dict[str, dict[str, list[Tensor]]] = {name: {kind: [] for kind in (CLEAN, *kinds)} for name in scores}
    of: list[Tensor] = []
    whole = set(starts.tolist())
    batches = [[row for row in batch if row in whole] for batch in alike(dataset, decisions, batch_size)]
    batches = [batch for batch in batches if batch]
    window = torch.arange(size)
    for batch, item in zip(batches, tqdm(DataLoader(dataset, batch_sampler=batches), desc="Scoring"), strict=True):
        at = torch.tensor(batch)
        rows = {key: value for key, value in item.items() if isinstance(value, Tensor)}
        told = int(decisions.told(rows["frame_index"])[0])
        normal = preprocess(constants.hold(rows | {ACTION: decisions.chunks(rows[ACTION], told)}))
        *past, _ = normal[ACTION].unbind(dim=1)
        past_told = {"history": torch.stack(past, dim=1) if past else None} if getattr(adapter, "history", 0) else {}
        bound = adapter.bind(normal, **past_told)
        chunk, before = action[at[:, None] + window], action[(at[:, None] + window - size).clamp(min=0)]
        other = action[_elsewhere(starts, episode, at, generator)[:, None] + window]
        raw = {CLEAN: chunk, **went_wrong(chunk, before, other, spread, generator)}
        for kind in (CLEAN, *kinds):
            wrong = preprocess(constants.hold(rows | {ACTION: raw[kind]}))[ACTION]
            for name, score in scores.items():
                values = bound.score(pad(wrong, size), score).double().cpu()
                found[name][kind].append(values.masked_fill((frame[at] < size) & (kind == "replayed"), torch.nan))
        of.append(episode[at])
    merged = {name: {kind: torch.cat(parts) for kind, parts in by.items()} for name, by in found.items()}
    return Chunks(merged, torch.cat(of))


def _elsewhere(starts: Tensor, episode: Tensor, at: Tensor, generator: torch.Generator) -> Tensor:
    """For each row a start of a chunk in another episode; of its own, if there is only one."""
    drawn = starts[torch.randint(len(starts), (len(at), 16), generator=generator)]
    elsewhere = (episode[drawn] != episode[at][:, None]).int().argmax(dim=1)
    return drawn.gather(1, elsewhere[:, None])[:, 0]


@torch.no_grad()
def losses(on_data: AdapterOnData, most: int, batch_size: int) -> tuple[float, float] | None:
    """The training's loss on frames that it has seen and on such that it has not; None where it is not known.

    Both are of the weights that inference uses, and of about as many frames.
    """
    seen = sorted(set(range(on_data.meta.total_episodes)) - set(on_data.episodes))
    if on_data.training is None or on_data.training.dataset.repo_id != on_data.data.repo_id or not seen:
        return None
    return _loss(on_data, seen, most, batch_size), _loss(on_data, on_data.episodes, most, batch_size)


def _loss(on_data: AdapterOnData, episodes: list[int], most: int, batch_size: int) -> float:
    adapter = on_data.adapter
    dataset = on_data.frames(episodes, adapter.config.action_delta_indices)
    picked = torch.linspace(0, len(dataset) - 1, min(most, len(dataset))).long().tolist()
    total = 0.0
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for item in DataLoader(Subset(dataset, picked), batch_size=batch_size):
            loss, _ = adapter.forward(on_data.preprocess(item))
            total += loss.item() * len(item[ACTION])
    return total / len(picked)
