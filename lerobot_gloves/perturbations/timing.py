"""Actions at the wrong time: chunks that come again, actions that come late or never."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import rand
from lerobot_gloves.perturbations.base import Perturbation, check_probability


@dataclass
class Laggy(Perturbation):
    """The chunk last emitted comes again instead of the new one: delay, stalls."""

    # Probability of a repetition, p_rep. The first chunk of an episode has nothing to repeat.
    p: float = 0.2

    def __post_init__(self) -> None:
        check_probability("Laggy", "p", self.p)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        repeats, (last,) = self._happens(self.p, chunk), self._states
        if last is not None:
            length = chunk.shape[1]
            # A chunk that is shorter than this one holds its last action until this one's end.
            last = torch.cat([last, last[:, -1:].expand(-1, max(0, length - last.shape[1]), -1)], dim=1)[:, :length]
        emitted = chunk.clone() if last is None else torch.where(repeats, last, chunk)
        self._states = [emitted]
        return emitted.clone()


@dataclass
class Delayed(Perturbation):
    """What is executed is the agent's action of some steps ago, inside a chunk and across chunks: latency.

    Until the agent's first action is due, it is held, which is harmless whether actions are targets or displacements;
    zero would be a target of its own.
    """

    # How many steps late an action comes, d. At the beginning of an episode the first action is held.
    steps: int = 4

    def __post_init__(self) -> None:
        if self.steps < 0:
            raise ValueError(f"Delayed: steps is {self.steps}, but must not be negative")

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        self._generators(chunk)  # draws nothing, but what is due belongs to the environments that it was reset for
        before = self._state(ran)
        due = chunk[:, :1].expand(-1, self.steps, -1) if before is None else before
        actions = torch.cat([due, chunk], dim=1)
        self._states = [actions[:, i : i + self.steps] for i in range(chunk.shape[1] + 1)]
        return actions[:, : chunk.shape[1]].clone()


@dataclass
class Dropped(Perturbation):
    """Single actions get lost, each by itself: an unreliable connection."""

    # Probability that an action is lost. The first action of an episode never is.
    p: float = 0.2
    # What takes its place, as a share of the action executed last: 1 repeats that one, 0 executes zero, which stops a
    # robot whose actions are displacements, but is a target where they are targets.
    hold: float = 1.0

    def __post_init__(self) -> None:
        check_probability("Dropped", "p", self.p)
        check_probability("Dropped", "hold", self.hold)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        lost = rand((*chunk.shape[:2], 1), self._generators(chunk), like=chunk) < self.p
        last, executed = self._state(ran), []
        before = last
        for drop, action in zip(lost.unbind(dim=1), chunk.unbind(dim=1), strict=True):
            last = action.clone() if last is None else torch.where(drop, self.hold * last, action)
            executed.append(last)
        self._states = [before, *executed]
        return torch.stack(executed, dim=1)
