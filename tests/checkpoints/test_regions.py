"""Where chunks begin: thirds counted by hand, and regions that were planted."""

import torch

from lerobot_gloves.checkpoints.regions import clusters, regions


def test_thirds_are_of_the_episode():
    progress = torch.tensor([0.0, 0.3, 0.34, 0.7, 0.99])
    found = regions(progress, torch.empty(5, 0), [])
    assert [(one.name, one.members.tolist()) for one in found] == [
        ("first third of an episode", [True, True, False, False, False]),
        ("second third of an episode", [False, False, True, False, False]),
        ("last third of an episode", [False, False, False, True, True]),
    ]
    assert [one.name for one in regions(torch.zeros(3), torch.ones(3, 2), ["x", "y"])] == ["first third of an episode"]


def test_planted_regions_are_found_and_named_by_what_sets_them_apart():
    """Four corners of x and y, whatever their units; z goes along with x, and w never moves."""
    generator = torch.Generator().manual_seed(0)
    corner = torch.arange(80) % 4
    x, y = (corner // 2).float(), 1000.0 * (corner % 2)
    state = torch.stack([x, y, 2 * x, torch.full((80,), 0.3)], dim=1)
    state[:, :3] += torch.tensor([0.01, 10.0, 0.02]) * torch.randn(80, 3, generator=generator)
    found = regions(corner / 4, state, ["x", "y", "z", "w"])[3:]
    assert [one.members.tolist() for one in found] == [(corner == index).tolist() for index in range(4)]
    for one in found:
        assert "w" not in one.name and "y" in one.name and ("x" in one.name) != ("z" in one.name), one.name
    assert found[0].name.startswith("state 1: ")


def test_there_are_no_more_regions_than_states():
    state = torch.tensor([[0.0], [0.0], [1.0]])
    assert len(regions(torch.zeros(3), state, ["x"])) == 1 + 2
    assert clusters(state, 1).tolist() == [0, 0, 0]
