"""The checkerboard toy: its geometry, its measures, and a small version of the whole."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from scipy import stats

from lerobot_gloves.scores import ReverseScore
from tests.gaussian import seeded


@pytest.fixture(scope="module")
def toy() -> ModuleType:
    folder = str(Path(__file__).parents[2] / "scripts")
    sys.path.insert(0, folder)
    try:
        import checkerboard
    finally:
        sys.path.remove(folder)
    return checkerboard


def cell_of(points: torch.Tensor) -> np.ndarray:
    """Column and row of points of the square, counted from its lower left corner."""
    return np.floor(points.numpy() + 2).astype(int)


def test_eight_of_sixteen_cells_are_occupied_and_no_two_share_a_side(toy):
    cells = [tuple(corner) for corner in cell_of(toy.CORNERS)]
    assert len(set(cells)) == toy.CLASSES == 8
    assert all(0 <= x < 4 and 0 <= y < 4 for x, y in cells)
    assert all(abs(a - c) + abs(b - d) > 1 for a, b in cells for c, d in cells if (a, b) != (c, d))


def test_class_5_touches_class_7_and_class_0_is_farthest_from_it(toy):
    """The paper names these two neighbours."""
    distances = (toy.CORNERS - toy.CORNERS[7]).double().norm(dim=1)[:7]
    assert distances.argmin() == 5
    assert distances.argmax() == 0


def test_points_of_a_class_are_uniform_in_its_cell(toy):
    for label in range(8):
        points = toy.sample_cells(torch.full((4000,), label), seeded(label))
        assert (cell_of(points) == cell_of(toy.CORNERS[label])).all()
        for axis in range(2):
            assert stats.kstest(points[:, axis].numpy() % 1, "uniform").pvalue > 1e-3


def test_every_point_gets_the_cell_of_its_own_label(toy):
    labels = torch.randint(8, (500,), generator=seeded(0))
    points = toy.sample_cells(labels, seeded(1))
    for label in range(8):
        assert torch.equal(toy.in_cell(points, label), labels == label)


def test_points_outside_a_cell_are_uniform_on_the_other_fifteen(toy):
    points = toy.sample_outside(5, 15_000, seeded(2))
    assert points.shape == (15_000, 2)
    column, row = cell_of(points).T
    counts = np.bincount(4 * row + column, minlength=16)
    queried = 4 * 2 + 2
    assert counts[queried] == 0
    assert stats.chisquare(np.delete(counts, queried)).pvalue > 1e-3


def test_auroc_equals_the_mann_whitney_statistic_ties_included(toy):
    rng = np.random.default_rng(0)
    usual, unusual = rng.normal(size=80).round(1), rng.normal(0.7, size=60).round(1)
    expected = stats.mannwhitneyu(unusual, usual).statistic / (80 * 60)
    assert toy.auroc(torch.from_numpy(usual), torch.from_numpy(unusual)) == pytest.approx(expected, rel=1e-12)


def test_the_label_reaches_the_flow_normalised(toy):
    seen = []
    flow = toy.ConditionalFlow()
    flow.forward = lambda x, t, c: seen.append(c) or x
    flow.bind(torch.arange(8))(torch.zeros(8, 1, 2), torch.zeros(8))
    assert torch.equal(seen[0], torch.arange(8) / 7)


@pytest.mark.slow
def test_a_briefly_trained_flow_meets_what_the_toy_promises(toy):
    """Under a tenth of the script's training is enough for the figures that the project holds itself to."""
    flow = toy.train(steps=1000, seed=0)
    detector = toy.Detector(flow, ReverseScore(steps=5))
    rows = toy.measure(detector, detector.calibrate(seed=1), seed=2)
    assert np.mean([row["inside_accepted"] for row in rows]) >= 0.93
    assert np.mean([row["outside_accepted"] for row in rows]) <= 0.03
    assert min(row["wrong_class_auroc"] for row in rows) >= 0.999
    # A gate that admits everything would pass the first line.
    assert np.mean([row["inside_accepted"] for row in rows]) == pytest.approx(0.95, abs=0.02)
