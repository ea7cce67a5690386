"""Agents drawn anew for every item of a copilot's training."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.direction import Held, Rotated
from lerobot_gloves.faults.fault import Fault, Units
from lerobot_gloves.faults.noise import Drift, Noise
from lerobot_gloves.faults.person import Driven
from lerobot_gloves.faults.size import Chatter, DeadZone, Offset, Quantised, Scale
from lerobot_gloves.faults.timing import Delay, Dropped, Replay
from lerobot_gloves.generators import rand

FAULTS: dict[str, type[Fault]] = {
    "held": Held,
    "driven": Driven,
    "rotated": Rotated,
    "scale": Scale,
    "offset": Offset,
    "deadzone": DeadZone,
    "quantised": Quantised,
    "chatter": Chatter,
    "noise": Noise,
    "drift": Drift,
    "dropped": Dropped,
    "delay": Delay,
    "replay": Replay,
}
"""Faults by name, in the order in which an agent that has several of them suffers them."""


@dataclass(frozen=True)
class RandomisedAgents:
    """Draws agents: some healthy, most with one fault, some with several.

    Attributes:
        faults: Which faults there are, names of `FAULTS`.
        healthy: Share of the agents that have none.
        several: Of the others, the share that has two.

    Raises:
        ValueError: If a fault is not one, none is named, or a share is outside [0, 1].
    """

    faults: Sequence[str] = tuple(FAULTS)
    healthy: float = 0.2
    several: float = 0.25

    def __post_init__(self) -> None:
        if unknown := [name for name in self.faults if name not in FAULTS]:
            raise ValueError(f"there is no fault {unknown[0]!r}: choose from {', '.join(FAULTS)}")
        if not self.faults:
            raise ValueError(f"RandomisedAgents: no fault is named: choose from {', '.join(FAULTS)}")
        for name in ("healthy", "several"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"RandomisedAgents: {name} is {getattr(self, name)}, but must lie in [0, 1]")

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        """What B agents, each drawn anew, would have proposed where the expert made `history`; see `Fault`."""
        for name, has in zip(self._ordered, self.draw(len(history), history, generator).T, strict=True):
            if has.any():
                faulty = FAULTS[name]()(history[has], units, generator)
                history = history.index_put((has,), torch.where(units.varies, faulty, history[has]))
        return history

    def draw(self, agents: int, like: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Which faults so many agents have, bool (agents, faults), in the order of `FAULTS`."""
        ranks = rand((agents, len(self._ordered)), generator, like=like).argsort(dim=1).argsort(dim=1)
        number = torch.where(rand((agents, 1), generator, like=like) < self.several, 2, 1)
        number = torch.where(rand((agents, 1), generator, like=like) < self.healthy, 0, number)
        return ranks < number

    @property
    def _ordered(self) -> list[str]:
        return [name for name in FAULTS if name in self.faults]
