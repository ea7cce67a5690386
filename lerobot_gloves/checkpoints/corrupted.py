"""Held-out chunks of the expert as randomised agents would propose them, and what an adapter's settings make of each.

Nothing is played: a setting is judged by how near it comes to what the expert did, at the moments of demonstrations.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor
from torch.utils.data import DataLoader
from tqdm import tqdm

from lerobot_gloves.adapter import BoundAdapter
from lerobot_gloves.checkpoints.on_data import AdapterOnData
from lerobot_gloves.checkpoints.scoring import Decisions, alike
from lerobot_gloves.checkpoints.statistics import Constants, action_units
from lerobot_gloves.faults import RandomisedAgents, Units
from lerobot_gloves.generators import spawn

HEALTHY = "healthy"
BEFORE = 4
"""How many decisions an agent looks back, whose chunks come again or late, if the adapter does not say."""


@dataclass(frozen=True)
class Setting:
    """An editor, and what it is told of a test, if it asks one.

    Attributes:
        editor: An instance of one of the adapter's editors.
        score: Specification of a calibrated score.
        alpha: Level of the test.
        threshold: The largest score that passes.
    """

    editor: Any
    score: str | None = None
    alpha: float | None = None
    threshold: float | None = None


@dataclass(frozen=True)
class Corrupted:
    """What became of N chunks of the expert in the hands of K agents, and of S settings after them.

    Distances are the mean Euclidean ones of an action, in the adapter's normalised units, as the wrapper logs them.

    Attributes:
        kinds: What was wrong with each agent: `HEALTHY` for nothing, or the fault's name.
        settings: The settings.
        proposed: From the expert's chunk to what was proposed, (N, K).
        edited: From the expert's chunk to what was made of that, (S, N, K).
        moved: From what was proposed to what was made of it, (S, N, K).
        scores: Of what was proposed, (N, K), by specification.
    """

    kinds: Sequence[str]
    settings: Sequence[Setting]
    proposed: Tensor
    edited: Tensor
    moved: Tensor
    scores: Mapping[str, Tensor]


def corrupt_and_edit(
    on_data: AdapterOnData,
    settings: Sequence[Setting],
    scores: Mapping[str, Any],
    faults: Sequence[str],
    most: int,
    batch_size: int,
) -> Corrupted:
    """Let randomised agents propose an expert's held-out chunks, and an adapter's settings edit all of them.

    Each context is encoded once, for all agents and settings, unless the adapter reads a history, which is another for
    each agent. A setting edits every proposal: whether a gate would have let it pass is told from the scores later.

    Args:
        on_data: Adapter and data.
        settings: What to try.
        scores: Scores to take, by specification; those of the settings among them.
        faults: Kinds of faults, names of `lerobot_gloves.faults.FAULTS`; one agent has none, each of the others one.
        most: About how many chunks; as many frames lie between two as that asks for, of every episode alike.
        batch_size: Chunks of an agent edited at once.

    Raises:
        ValueError: If there is no such fault, or no episode is as long as a chunk.
    """
    agents = {name: RandomisedAgents((name,), healthy=0.0, several=0.0) for name in faults}
    kinds, reads_history = (HEALTHY, *agents), getattr(on_data.adapter, "history", 0) > 0
    proposed: list[Tensor] = []
    edited: list[Tensor] = []
    moved: list[Tensor] = []
    scored: list[Tensor] = []
    generator = torch.Generator().manual_seed(0)
    for batch in _batches(on_data, most, batch_size):
        clean, size = batch.chunks[:, -1], batch.chunks.shape[2]
        bound = None
        for kind in kinds:
            chunks = batch.chunks if kind == HEALTHY else agents[kind](batch.chunks, batch.units, generator)
            *before, proposal = chunks.unbind(dim=1)
            if bound is None or reads_history:
                bound = batch.bind(on_data.adapter, before)
            proposed.append(batch.distance(proposal, clean))
            scored += [bound.score(proposal, score, length=size).double().cpu() for score in scores.values()]
            for setting in settings:
                result = bound.edit(
                    proposal,
                    setting.editor,
                    score=None if setting.score is None else scores[setting.score],
                    threshold=setting.threshold,
                    length=size,
                    generator=spawn(0, len(proposal)),  # the same draws for every setting
                )
                edited.append(batch.distance(result, clean))
                moved.append(batch.distance(result, proposal))
    if not proposed:
        size = on_data.adapter.config.chunk_size
        raise ValueError(f"no episode is as long as a chunk of the adapter, {size} actions")

    def gathered(parts: list[Tensor], each: int) -> Tensor:
        """Of a list over batches, kinds and `each` things: (each, N, K)."""
        per_batch = len(kinds) * each
        batches = [parts[begin : begin + per_batch] for begin in range(0, len(parts), per_batch)]
        return torch.cat([torch.stack(one).unflatten(0, (len(kinds), each)).permute(1, 2, 0) for one in batches], dim=1)

    return Corrupted(
        kinds=kinds,
        settings=settings,
        proposed=gathered(proposed, 1)[0],
        edited=gathered(edited, len(settings)),
        moved=gathered(moved, len(settings)),
        scores=dict(zip(scores, gathered(scored, len(scores)), strict=True)) if scores else {},
    )


@dataclass(frozen=True)
class _Batch:
    """Contexts of B chunks of the expert, and these with those before them, normalised.

    Attributes:
        observation: What `bind` takes.
        chunks: (B, h + 1, T, A), the oldest first.
        units: The robot's units among normalised actions.
        varies: Which entries of an action change in the data, bool (A,).
    """

    observation: Mapping[str, Tensor]
    chunks: Tensor
    units: Units
    varies: Tensor

    def bind(self, adapter: Any, before: Sequence[Tensor]) -> BoundAdapter:
        if not getattr(adapter, "history", 0):
            return adapter.bind(self.observation)
        return adapter.bind(self.observation, torch.stack(list(before), dim=1) if before else None)

    def distance(self, one: Tensor, other: Tensor) -> Tensor:
        return ((one - other) * self.varies).norm(dim=-1).mean(dim=-1).double().cpu()


def _batches(on_data: AdapterOnData, most: int, batch_size: int) -> Iterator[_Batch]:
    adapter, preprocess = on_data.adapter, on_data.preprocess
    size, history = adapter.config.chunk_size, getattr(adapter, "history", 0) or BEFORE
    stride = getattr(adapter, "stride", getattr(adapter.config, "n_action_steps", size))
    # Where chunks can begin: the last of an episode's frames have too few behind them.
    frames = sum(max(0, int(on_data.meta.episodes["length"][one]) - size + 1) for one in on_data.episodes)
    decisions = Decisions((size,), max(1, frames // most), stride, history)
    dataset = on_data.frames(on_data.episodes, decisions.indices)
    constants = Constants(preprocess)
    loader = DataLoader(dataset, batch_sampler=alike(dataset, decisions, batch_size))
    for item in tqdm(loader, desc="Editing", unit="batch"):
        whole = ~item["action_is_pad"][:, -size:].any(dim=1)
        if not whole.any():
            continue
        rows = {key: value[whole] for key, value in item.items() if isinstance(value, Tensor)}
        chunks = decisions.chunks(rows[ACTION], int(decisions.told(rows["frame_index"])[0]))
        held = constants.hold(rows | {ACTION: chunks})
        normal, units = preprocess(held), action_units(preprocess, constants, held)
        yield _Batch(normal, normal[ACTION], units, units.varies)
