"""What an adapter's scores tell apart: an expert's chunks, held out of its training, and the same chunks gone wrong."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor
from torch.utils.data import DataLoader
from tqdm import tqdm

from lerobot_gloves.adapter import pad
from lerobot_gloves.checkpoints.on_data import AdapterOnData
from lerobot_gloves.checkpoints.scoring import Decisions, alike
from lerobot_gloves.checkpoints.statistics import Constants
from lerobot_gloves.conformal import ConformalGate, auroc
from lerobot_gloves.scores.score import needs_posterior

KINDS = ("noised", "scaled", "shifted", "replayed", "another moment")
CLEAN = "clean"
AGENT, BESIDE = "agent", "expert"
"""Proposals of an agent for the same observations, and the expert's chunks cut to as many actions as an agent's."""
RESAMPLES = 500
KNOWS = 0.6
"""An adapter that knows what is to be done where has at least this area between a context's own chunk and another's."""


@dataclass(frozen=True)
class Chunks:
    """Scores of N of the expert's chunks, as they are and gone wrong.

    Attributes:
        scores: By score and kind (`CLEAN` and `KINDS`; `AGENT` and `BESIDE` where they are asked for), (N,) each. An
            episode's first chunk cannot be replayed, so there that is NaN.
        episode: Which episode each is of, (N,).
        progress: Which share of its episode went before it, in [0, 1), (N,).
        state: The robot's state where it begins, raw, (N, S); S is 0 where the data have none.
        proposed: How many actions of an agent's proposals count; 0 where there are none.
    """

    scores: Mapping[str, Mapping[str, Tensor]]
    episode: Tensor
    progress: Tensor
    state: Tensor
    proposed: int = 0

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

    def threshold(self, score: str, alpha: float, clean: str = CLEAN) -> float:
        """The largest score that a gate calibrated on the clean chunks (`CLEAN` or `BESIDE`) lets pass.

        It is infinite where they are too few for alpha.
        """
        return ConformalGate(self.scores[score][clean], alpha).threshold

    def stopped(self, score: str, kind: str, alpha: float) -> float:
        """The share of the chunks of a kind that a gate calibrated on the clean ones turns away."""
        wrong = self.scores[score][kind]
        return (wrong[~wrong.isnan()] > self.threshold(score, alpha)).double().mean().item()

    def p_values(self, score: str) -> Tensor:
        """P-values of the clean chunks, each among those of the other episodes, double, (N,); 1 if there are none."""
        clean, found = self.scores[score][CLEAN], torch.ones(len(self.episode), dtype=torch.float64)
        for one in self.episode.unique():
            own = self.episode == one
            if not own.all():
                found[own] = ConformalGate(clean[~own]).p_value(clean[own])
        return found


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


def spread_out(lengths: Sequence[int], size: int, most: int) -> tuple[int, int]:
    """How many frames lie between two chunks so that there are about `most`, and how many there are then.

    Args:
        lengths: Frames of each episode.
        size: Actions of a chunk.
        most: About how many chunks. Where there are fewer places than that, one begins at each.

    Raises:
        ValueError: If no episode is as long as a chunk.
    """
    places = [length - size + 1 for length in lengths if length >= size]
    if not places:
        raise ValueError(f"no episode is as long as a chunk of the adapter, {size} actions")
    every = max(1, sum(places) // most)
    return every, sum(-(-count // every) for count in places)


@torch.no_grad()
def tell(
    on_data: AdapterOnData,
    scores: Mapping[str, Any],
    most: int,
    batch_size: int,
    kinds: Sequence[str] = KINDS,
    *,
    agent: Callable[[dict[str, Any]], Tensor] | None = None,
    proposed: int = 0,
    seed: int = 0,
) -> Chunks:
    """Score the chunks of held-out episodes, as they are and gone wrong.

    Args:
        on_data: Adapter and data.
        scores: The scores by name.
        most: About how many chunks, see `spread_out`; of every episode alike.
        batch_size: Chunks scored at once.
        kinds: How they go wrong, some of `KINDS`.
        agent: From frames of the dataset to what an agent proposes there, raw (B, n, A).
        proposed: How many actions an agent's proposals have that are not asked for here, but known; 0 for none.
        seed: What the wrong chunks are drawn by.

    Raises:
        ValueError: If no episode is as long as a chunk.
    """
    adapter, preprocess = on_data.adapter, on_data.preprocess
    size = adapter.config.chunk_size
    history = getattr(adapter, "history", 0) if any(map(needs_posterior, scores.values())) else 0
    stride = adapter.stride if history else 1
    every, _ = spread_out(on_data.lengths, size, most)
    decisions = Decisions((size,), every, stride, history)
    dataset = on_data.frames(on_data.episodes, decisions.indices)
    columns = dataset.hf_dataset.with_format("torch", columns=[ACTION, "episode_index", "frame_index"])[:]
    action, episode, frame = (columns[name] for name in (ACTION, "episode_index", "frame_index"))
    action = action.float()
    spread = torch.as_tensor(on_data.meta.stats[ACTION]["std"]).float()
    starts = torch.tensor([row for row in range(len(action) - size + 1) if episode[row] == episode[row + size - 1]])
    generator, constants = torch.Generator().manual_seed(seed), Constants(preprocess)
    called = (CLEAN, *kinds, *([AGENT] if agent else []), *([BESIDE] if agent or proposed else []))
    found: dict[str, dict[str, list[Tensor]]] = {name: {kind: [] for kind in called} for name in scores}
    at_all: list[Tensor] = []
    states: list[Tensor] = []
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
        if agent is not None:
            raw[AGENT] = agent(item)[:, :size].to(chunk)
            proposed = raw[AGENT].shape[1]
        if proposed:
            raw[BESIDE] = chunk[:, :proposed]
        for kind in called:
            normalised = preprocess(constants.hold(rows | {ACTION: raw[kind]}))[ACTION]
            length = normalised.shape[1]
            for name, score in scores.items():
                values = bound.score(pad(normalised, size), score, length=length).double().cpu()
                found[name][kind].append(values.masked_fill((frame[at] < size) & (kind == "replayed"), torch.nan))
        at_all.append(at)
        states.append(rows[OBS_STATE].flatten(1).cpu() if OBS_STATE in rows else torch.empty(len(at), 0))
    at = torch.cat(at_all)
    merged = {name: {kind: torch.cat(parts) for kind, parts in by.items()} for name, by in found.items()}
    ends = torch.tensor(on_data.meta.episodes["length"])[episode[at]]
    return Chunks(merged, episode[at], frame[at] / ends, torch.cat(states), proposed)


def _elsewhere(starts: Tensor, episode: Tensor, at: Tensor, generator: torch.Generator) -> Tensor:
    """For each row a start of a chunk in another episode; of its own, if there is only one."""
    drawn = starts[torch.randint(len(starts), (len(at), 16), generator=generator)]
    elsewhere = (episode[drawn] != episode[at][:, None]).int().argmax(dim=1)
    return drawn.gather(1, elsewhere[:, None])[:, 0]
