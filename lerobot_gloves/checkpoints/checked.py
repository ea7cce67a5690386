"""What a check of an adapter finds, all of it: what its report, its page and its card are made of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from lerobot_gloves.checkpoints.losses import losses
from lerobot_gloves.checkpoints.on_data import AdapterOnData
from lerobot_gloves.checkpoints.regions import Region, regions
from lerobot_gloves.checkpoints.telling import AGENT, Chunks, tell, verdict

FORGOTTEN = 1.5
"""A held-out loss of more than so many times the training's is that of demonstrations known by heart."""


class Proposals(Protocol):
    """Scores of an agent's proposals that are known already: by name (M,), all of `length` actions."""

    length: int
    scores: Mapping[str, Tensor]


@dataclass(frozen=True)
class Checked:
    """An adapter on an expert's data.

    Attributes:
        adapter: What names it.
        data: The dataset's name.
        chunks: Scores of the expert's chunks, right and wrong, and of an agent's proposals if there is one.
        regions: Where the chunks begin.
        losses: The training's loss on episodes that it has seen and on others; None where it is not known.
        usable: Whether the adapter can tell what is to be done where.
        line: The verdict.
        agent: What names the agent that was asked for proposals, or the log that holds them, if there is one.
        proposals: The scores of an agent's proposals by score, (M,); empty without an agent.
    """

    adapter: str
    data: str
    chunks: Chunks
    regions: list[Region]
    losses: tuple[float, float] | None
    usable: bool
    line: str
    agent: str
    proposals: Mapping[str, Tensor]

    @property
    def loss_line(self) -> str:
        """What the losses say; empty where they are not known."""
        if self.losses is None:
            return ""
        trained, held_out = self.losses
        heart = ": known by heart" if held_out > FORGOTTEN * trained else ""
        ratio = f"{held_out / trained:.2f} times as much"
        return f"loss {trained:.4f} on episodes of the training, {held_out:.4f} on the others, {ratio}{heart}"


def check_adapter(
    opened: AdapterOnData,
    scores: Mapping[str, Any],
    most: int,
    batch_size: int,
    *,
    agent: str = "",
    ask: Callable[[dict[str, Any]], Tensor] | None = None,
    known: Proposals | None = None,
) -> Checked:
    """Check an adapter.

    Args:
        opened: Adapter and data.
        scores: The scores by name.
        most: About how many chunks to score.
        batch_size: Chunks scored at once.
        agent: What an agent's proposals are called, if there are some.
        ask: From frames of the dataset to what the agent proposes there, raw (B, n, A).
        known: The scores of its proposals instead.

    Raises:
        ValueError: If no episode is as long as a chunk.
    """
    chunks = tell(opened, scores, most, batch_size, agent=ask, proposed=0 if known is None else known.length)
    usable, line = verdict(chunks)
    proposals = {name: by[AGENT] for name, by in chunks.scores.items()} if ask else {}
    return Checked(
        adapter=str(opened.adapter.config.pretrained_path),
        data=opened.data.repo_id,
        chunks=chunks,
        regions=regions(chunks.progress, chunks.state, _names(opened, chunks.state.shape[1])),
        losses=losses(opened, most, batch_size),
        usable=usable,
        line=line,
        agent=agent,
        proposals=proposals if known is None else known.scores,
    )


def _names(opened: AdapterOnData, count: int) -> list[str]:
    """What the dataset calls the entries of the state, which it may do in several forms, or not at all."""
    names = opened.meta.features.get(OBS_STATE, {}).get("names")
    if isinstance(names, dict):
        (names,) = names.values() if len(names) == 1 else (list(names),)
    return list(names) if names and len(names) == count else [f"entry {index}" for index in range(count)]
