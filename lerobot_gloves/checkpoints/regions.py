"""Where in a task chunks begin: thirds of an episode, and regions of the robot's state."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

THIRDS = ("first third", "second third", "last third")
REGIONS = 4
RESTARTS, ROUNDS = 8, 30
ALIKE = 0.9
"""Two entries of a state that correlate more than this say the same of a region."""


@dataclass(frozen=True)
class Region:
    """A part of the task.

    Attributes:
        name: What it is, for people.
        members: Which of N chunks begin in it, bool (N,).
    """

    name: str
    members: Tensor


def regions(progress: Tensor, state: Tensor, names: Sequence[str]) -> list[Region]:
    """The thirds of an episode, and up to four regions of the state, those that any chunk begins in.

    Regions of the state are found by k-means of its entries, each in units of its spread, the best of several tries,
    so that every chunk is in one. They are named by the entry in which they are furthest from the middle and by the
    next one that does not go along with it, with the range that nine tenths of their chunks have there, and numbered
    by when in an episode they come.

    Args:
        progress: Which share of its episode went before each chunk, (N,).
        state: The state there, (N, S); of S = 0 there are no regions.
        names: What its entries are called, S of them.
    """
    third = (3 * progress).long().clamp(max=2)
    found = [Region(f"{name} of an episode", third == index) for index, name in enumerate(THIRDS)]
    spread = state.std(dim=0, correction=0) if state.shape[1] else torch.zeros(0)
    moving = spread > 1e-6 * state.abs().amax(dim=0) if state.shape[1] else torch.zeros(0, dtype=torch.bool)
    if moving.any():
        seen = state[:, moving]
        units = (seen - seen.mean(dim=0)) / spread[moving]
        mine = [name for name, moves in zip(names, moving.tolist(), strict=True) if moves]
        label = clusters(units, min(REGIONS, len(units.unique(dim=0))))
        members = sorted((label == one for one in label.unique()), key=lambda rows: progress[rows].mean().item())
        found += [
            Region(f"state {number}: {_called(seen, units, rows, mine)}", rows)
            for number, rows in enumerate(members, start=1)
        ]
    return [region for region in found if region.members.any()]


def clusters(points: Tensor, count: int) -> Tensor:
    """By k-means, which of `count` clusters each of the points (N, S) is in, (N,): the best of several tries."""
    generator = torch.Generator().manual_seed(0)
    points, best, least = points.double(), torch.zeros(len(points), dtype=torch.long), torch.inf
    for _ in range(RESTARTS):
        centres = points[torch.randperm(len(points), generator=generator)[:count]]
        for _ in range(ROUNDS):
            label = torch.cdist(points, centres).argmin(dim=1)
            # A centre that nobody is nearest to stays where it is.
            centres = torch.stack(
                [points[label == one].mean(dim=0) if (label == one).any() else centres[one] for one in range(count)]
            )
        far = torch.cdist(points, centres).amin(dim=1).square().sum().item()
        if far < least:
            best, least = torch.cdist(points, centres).argmin(dim=1), far
    return best


def _called(state: Tensor, units: Tensor, rows: Tensor, names: Sequence[str]) -> str:
    """A region by the two entries that say most of it, with their ranges."""
    order = units[rows].mean(dim=0).abs().argsort(descending=True).tolist()
    alike = (units.T @ units / len(units)).abs()
    others = [entry for entry in order[1:] if alike[order[0], entry] < ALIKE]
    low, high = state[rows].double().quantile(torch.tensor([0.05, 0.95], dtype=torch.float64), dim=0)
    return ", ".join(f"{names[one]} {low[one]:.3g} to {high[one]:.3g}" for one in [order[0], *others[:1]])
