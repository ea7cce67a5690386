"""Noise on what is proposed, white and smooth.

Half of the agents have it equal on all entries in units of the data, half in the robot's: policies err in the one,
motors in the other, and where the expert hardly ever turns the hand, a little noise on a rotation is large.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_gloves.faults.fault import Fault, Range, Units, even
from lerobot_gloves.generators import rand, randn


@dataclass(frozen=True)
class Noise(Fault):
    """White noise on every entry."""

    # Standard deviation on an entry of middling spread, in units of the data's.
    sigma: Range = (0.1, 3.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        sigma = even(self.sigma, history, generator) * _of_entries(history, units, generator)
        return history + sigma * randn(history.shape, generator, like=history)


@dataclass(frozen=True)
class Drift(Fault):
    """Smooth noise, which goes on from chunk to chunk: a first-order autoregressive process over all actions."""

    # Its standard deviation on an entry of middling spread, in units of the data's.
    sigma: Range = (0.1, 1.5)
    # Its correlation time, in actions.
    time: Range = (3.0, 30.0)

    def __call__(self, history: Tensor, units: Units, generator: torch.Generator | None = None) -> Tensor:
        keep = torch.exp(-1 / even(self.time, history, generator, log=True))[:, 0, 0]
        noise = randn(history.shape, generator, like=history).flatten(1, 2)
        state, states = noise[:, 0], [noise[:, 0]]
        for step in range(1, noise.shape[1]):
            state = keep * state + (1 - keep**2).sqrt() * noise[:, step]
            states.append(state)
        drift = torch.stack(states, dim=1).view_as(history)
        return history + even(self.sigma, history, generator) * _of_entries(history, units, generator) * drift


def _of_entries(history: Tensor, units: Units, generator: torch.Generator | None) -> Tensor:
    """By what noise is multiplied on each entry of each agent, (B, 1, 1, A)."""
    robots = rand((len(history), 1, 1, 1), generator, like=history) < 0.5
    return torch.where(robots, units.alike().to(history), 1.0)
