"""Randomised agents: what may be wrong with whoever proposes, drawn anew for every item of a copilot's training.

A history (B, K, T, A) holds the chunks of K decisions of one episode, the oldest first, as the expert made them. An
agent is one draw for all of them: which faults it has and how strong they are, the same at every decision; what happens
by chance happens anew at each. Actions are normalised, so that strengths are in units of the data's spread; `zero` (A,)
is where the raw action 0, standing still, lies among them.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.generators import rand, randn

type Range = tuple[float, float]
"""Between what a strength is drawn."""


class Fault(ABC):
    """Something that may be wrong with an agent, of random strength."""

    @abstractmethod
    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """What B agents with this fault would have proposed.

        Args:
            history: Normalised chunks of K decisions, (B, K, T, A), the oldest first.
            zero: The normalised raw action 0, (A,).
            generator: Source of strengths and chances.

        Returns:
            A new tensor (B, K, T, A).
        """


@dataclass(frozen=True)
class Noise(Fault):
    """White noise on every entry."""

    # Standard deviation, in units of the data's.
    sigma: Range = (0.1, 3.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        return history + _even(self.sigma, history, generator) * randn(history.shape, generator, like=history)


@dataclass(frozen=True)
class Drift(Fault):
    """Smooth noise, which goes on from chunk to chunk: a first-order autoregressive process over all actions."""

    # Its standard deviation, in units of the data's.
    sigma: Range = (0.1, 1.5)
    # Its correlation time, in actions.
    time: Range = (3.0, 30.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        keep = torch.exp(-1 / _even(self.time, history, generator, log=True))[:, 0, 0]
        noise = randn(history.shape, generator, like=history).flatten(1, 2)
        state, states = noise[:, 0], [noise[:, 0]]
        for step in range(1, noise.shape[1]):
            state = keep * state + (1 - keep**2).sqrt() * noise[:, step]
            states.append(state)
        drift = torch.stack(states, dim=1).view_as(history)
        return history + _even(self.sigma, history, generator) * drift


@dataclass(frozen=True)
class Replay(Fault):
    """The chunk last emitted comes again instead of the new one."""

    # Probability of a repetition at a decision.
    p: Range = (0.1, 0.7)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        repeats = _happens(self.p, history, generator)
        emitted = [history[:, 0]]
        for decision in range(1, history.shape[1]):
            emitted.append(torch.where(repeats[:, decision], emitted[-1], history[:, decision]))
        return torch.stack(emitted, dim=1)


@dataclass(frozen=True)
class Delay(Fault):
    """Every action comes some steps late, the first one until then."""

    # How many steps, as a share of a chunk's length.
    steps: Range = (0.1, 1.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        actions = history.flatten(1, 2)
        late = (_even(self.steps, history, generator)[:, 0, 0] * history.shape[2]).round().long().clamp(min=1)
        source = (torch.arange(actions.shape[1], device=history.device)[None] - late).clamp(min=0)
        return actions.gather(1, source[..., None].expand_as(actions)).view_as(history)


@dataclass(frozen=True)
class Scale(Fault):
    """Chunks scaled, hesitation and haste: some of them, or all."""

    # The factor.
    factor: Range = (0.1, 2.5)
    # Probability that a chunk is scaled.
    p: Range = (0.3, 1.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        scaled = zero + _even(self.factor, history, generator, log=True) * (history - zero)
        return torch.where(_happens(self.p, history, generator), scaled, history)


@dataclass(frozen=True)
class Offset(Fault):
    """A constant on one entry of the action, to either side: in some of the chunks, or all."""

    # How much, in units of the data's spread.
    size: Range = (0.2, 3.0)
    # Probability that a chunk is shifted.
    p: Range = (0.3, 1.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        side = torch.where(rand((len(history), 1, 1, 1), generator, like=history) < 0.5, -1.0, 1.0).to(history)
        shift = side * _even(self.size, history, generator) * _one_entry(history, generator)
        return torch.where(_happens(self.p, history, generator), history + shift, history)


@dataclass(frozen=True)
class DeadZone(Fault):
    """Entries closer to 0 than a threshold are 0."""

    # The threshold, in units of the data's spread.
    threshold: Range = (0.1, 1.5)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        small = (history - zero).abs() < _even(self.threshold, history, generator, log=True)
        return torch.where(small, zero, history)


@dataclass(frozen=True)
class Quantised(Fault):
    """Entries rounded to multiples of a step."""

    # The step, in units of the data's spread.
    step: Range = (0.3, 2.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        step = _even(self.step, history, generator, log=True)
        return zero + step * ((history - zero) / step).round()


@dataclass(frozen=True)
class Dropped(Fault):
    """Single actions are lost: 0 comes in their place."""

    # Probability that an action is lost.
    p: Range = (0.05, 0.5)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        lost = rand((*history.shape[:3], 1), generator, like=history) < _even(self.p, history, generator)
        return torch.where(lost, zero, history)


@dataclass(frozen=True)
class Rotated(Fault):
    """Two entries of the action turned about 0: a frame that stands askew."""

    # The angle, in degrees, to either side.
    angle: Range = (10.0, 60.0)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        if history.shape[-1] < 2:
            return history.clone()
        side = torch.where(rand((len(history), 1, 1), generator, like=history) < 0.5, -1.0, 1.0).to(history)
        angle = side * torch.deg2rad(_even(self.angle, history, generator)[..., 0])
        order = rand((len(history), history.shape[-1]), generator, like=history).argsort(dim=1)
        first, second = (order[:, i, None, None, None].expand(*history.shape[:3], 1) for i in (0, 1))
        moved = history - zero
        x, y = moved.gather(3, first)[..., 0], moved.gather(3, second)[..., 0]
        turned = moved.scatter(3, first, (angle.cos() * x - angle.sin() * y)[..., None])
        return zero + turned.scatter(3, second, (angle.sin() * x + angle.cos() * y)[..., None])


@dataclass(frozen=True)
class Chatter(Fault):
    """One entry of the action has the other sign now and then, as a gripper that opens and closes by itself."""

    # Probability that an action's entry is turned round.
    p: Range = (0.05, 0.4)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        turned = rand((*history.shape[:3], 1), generator, like=history) < _even(self.p, history, generator)
        return torch.where(turned & _one_entry(history, generator).bool(), 2 * zero - history, history)


@dataclass(frozen=True)
class Held(Fault):
    """A person's commands: late, held for a whole chunk, one of eight directions of the two largest entries."""

    # Speed of a command, in units of the chunk's own mean speed.
    speed: Range = (0.6, 1.4)

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        meant = history.mean(dim=2, keepdim=True) - zero
        if history.shape[-1] > 1:
            largest = meant.abs().topk(2, dim=-1).indices
            pair = meant.gather(3, largest)
            angle = torch.atan2(pair[..., 1], pair[..., 0])
            snapped = (angle / (math.pi / 4)).round() * (math.pi / 4)
            held = torch.stack([snapped.cos(), snapped.sin()], dim=-1) * pair.norm(dim=-1, keepdim=True)
            meant = torch.zeros_like(meant).scatter(3, largest, held)
        late = torch.cat([meant[:, :1], meant[:, :-1]], dim=1)
        slow = rand((len(history), history.shape[1], 1, 1), generator, like=history) < 0.5
        command = torch.where(slow, late, meant) * _even(self.speed, history, generator)
        return (zero + command).expand_as(history).clone()


FAULTS: dict[str, type[Fault]] = {
    "held": Held,
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

    def __call__(self, history: Tensor, zero: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """What B agents, each drawn anew, would have proposed where the expert made `history`; see `Fault`."""
        for name, has in zip(self._ordered, self.draw(len(history), history, generator).T, strict=True):
            if has.any():
                faulty = FAULTS[name]()(history[has], zero, generator)
                history = history.index_put((has,), faulty)
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


def _even(bounds: Range, like: Tensor, generator: torch.Generator | None, *, log: bool = False) -> Tensor:
    """One number an agent, (B, 1, 1, 1), evenly between bounds, or evenly between their logarithms."""
    low, high = (math.log(bound) for bound in bounds) if log else bounds
    drawn = low + (high - low) * rand((len(like), 1, 1, 1), generator, like=like)
    return drawn.exp() if log else drawn


def _happens(p: Range, history: Tensor, generator: torch.Generator | None) -> Tensor:
    """Whether something happens to a chunk, bool (B, K, 1, 1), by a probability that each agent has for itself."""
    chance = _even(p, history, generator)
    return rand((*history.shape[:2], 1, 1), generator, like=history) < chance


def _one_entry(history: Tensor, generator: torch.Generator | None) -> Tensor:
    """1 at an entry of the action that each agent has for itself, else 0: (B, 1, 1, A)."""
    entry = (rand((len(history),), generator, like=history) * history.shape[-1]).long()
    return torch.nn.functional.one_hot(entry, history.shape[-1]).to(history)[:, None, None]
