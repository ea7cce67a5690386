"""The protocol that every adapter answers: bind a context, score proposals, edit them.

An adapter is a LeRobot policy, trained by `lerobot-train`, that has the four attributes of `Adapter` besides. The
wrapper knows no more of it than this page, so an adapter from another package works like ours.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from lerobot_gloves.generators import Generators


class BoundAdapter(Protocol):
    """An adapter with the context of B observations encoded, once for however many calls.

    Attributes:
        evaluations: Network evaluations per chunk since it was bound. A batch of n samples a context counts n.
    """

    evaluations: int

    def select(self, rows: Tensor) -> "BoundAdapter":
        """The same for some of the B contexts: `rows` is bool (B,)."""
        ...

    def score(self, chunk: Tensor, score: Any, length: int | None = None) -> Tensor:
        """Nonconformity of chunks (B, T, A), of whose actions the first `length` count: scores (B,).

        `score` is an instance of one of the adapter's `scores`; an adapter without any is never asked.
        """
        ...

    def edit(
        self,
        proposal: Tensor,
        editor: Any,
        *,
        score: Any = None,
        threshold: float | None = None,
        length: int | None = None,
        generator: Generators = None,
    ) -> Tensor:
        """Move proposals (B, T, A) towards the expert's: (B, T, A).

        `editor` is an instance of one of the adapter's `editors`. What else is given are fields of
        `lerobot_gloves.editors.Reference`, which an adapter that shares our editors completes by its models. `score` is
        None if the adapter has none, `threshold` without a calibration for it.
        """
        ...


@runtime_checkable
class Adapter(Protocol):
    """What a policy needs to be usable as `--policy.adapter`.

    Chunks are normalised by the adapter's own processors, T is its `config.chunk_size`.

    Attributes:
        editors: Its correction rules by the name that `--policy.method` gives, each a dataclass of numbers. One whose
            class says `needs_threshold = True` is refused at loading unless the adapter is calibrated for the score;
            one that says `needs_agent = True`, unless the adapter says `has_agent = True`: it has an agent flow.
        default_editor: The one to take where no method is given, as `--policy.method` gives it; "none" to edit nothing.
        scores: Its nonconformity scores by the name that `--policy.score` gives, likewise, the default first. An
            adapter without scores edits every proposal: it has no gate.

    One that says `gate_score`, as `--policy.score` gives it, has that for the default of a gate, instead of its first
    score; `gate_alpha` likewise is the level of a gate where nobody names one.

    One that says `history = H` above 0 is told what the agent proposed at its last H decisions, as it proposed it:
    `bind(observation, history)`, normalised (B, h, T, A), the oldest first, h growing from none to H in an episode. If
    a score of its says `needs_posterior = True`, what it finds depends on the history, so `gloves calibrate` tells the
    adapter the expert's own: `stride` is how many actions lie between two decisions there.
    """

    editors: Mapping[str, type]
    default_editor: str
    scores: Mapping[str, type]

    def bind(self, observation: Mapping[str, Tensor]) -> BoundAdapter:
        """Encode the context of B observations, as the adapter's own preprocessor returns them."""
        ...


def pad(chunk: Tensor, length: int) -> Tensor:
    """Repeat the last action of chunks (B, n, A) up to (B, `length`, A)."""
    return torch.cat([chunk, chunk[:, -1:].expand(-1, length - chunk.shape[1], -1)], dim=1)
