"""The paper's toy for out-of-distribution detection: an eight-class checkerboard and a conditional flow.

    python scripts/checkerboard.py --output outputs/checkerboard

Trains a small velocity field on one CPU thread (about a minute), calibrates the gate on fresh points, and
measures on fresh points again: how much of the queried cell the gate admits, how much of the rest of the square,
and how well the score tells the other classes apart. Prints a table for 1, 2 and 5 reverse steps, writes it to
`rows.json`, and draws the appendix's five figures (`checkerboard_figures.py`).

It is also the library in a nutshell: an "action chunk" here is a single action with two dimensions, (N, 1, 2),
and the context is a class label.
"""

import argparse
import itertools
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path

import checkerboard_figures as figures
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from lerobot_gloves.conformal import ConformalGate, auroc
from lerobot_gloves.flow import VelocityField, flow_matching_loss
from lerobot_gloves.scores import ReverseScore

ALPHA = 0.05
REVERSE_STEPS = (1, 2, 5)
CALIBRATION_PER_CLASS = 500
TEST_PER_CLASS = 10_000

CORNERS = torch.tensor(figures.CORNERS)
CLASSES = len(CORNERS)


def sample_cells(labels: Tensor, generator: torch.Generator) -> Tensor:
    """Points uniform in the cells of `labels` (N,): shape (N, 2)."""
    return CORNERS[labels] + torch.rand(len(labels), 2, generator=generator)


def in_cell(points: Tensor, label: int) -> Tensor:
    """Whether points (N, 2) lie in the cell of a class, bool (N,)."""
    return (points.floor() == CORNERS[label]).all(dim=1)


def sample_outside(label: int, number: int, generator: torch.Generator) -> Tensor:
    """Points uniform on the square [-2, 2]^2 outside the cell of a class: shape (number, 2)."""
    points = torch.empty(0, 2)
    while len(points) < number:
        drawn = 4 * torch.rand(number, 2, generator=generator) - 2
        points = torch.cat([points, drawn[~in_cell(drawn, label)]])
    return points[:number]


def every_class(number: int, of: list[int] | None = None) -> Tensor:
    """`number` labels of each class (or of those given): shape (classes * number,)."""
    return torch.tensor(list(range(CLASSES)) if of is None else of).repeat_interleave(number)


class ConditionalFlow(nn.Module):
    """Velocity field v(x, t | c) of two-dimensional points: an MLP on x and Fourier features of t and c.

    Args:
        width: Hidden units a layer.
        depth: Hidden layers.
    """

    def __init__(self, width: int = 128, depth: int = 3):
        super().__init__()
        self.register_buffer("frequencies", math.pi * torch.arange(1, 9))
        sizes = [2 + 2 * 17] + depth * [width]
        hidden = [nn.Sequential(nn.Linear(a, b), nn.SiLU()) for a, b in itertools.pairwise(sizes)]
        self.layers = nn.Sequential(*hidden, nn.Linear(width, 2))

    def forward(self, x: Tensor, t: Tensor, c: Tensor) -> Tensor:
        """Velocity at x (N, 1, 2), times t (N,) and normalised labels c (N,): shape (N, 1, 2)."""
        features = [x[:, 0]]
        for scalar in (t[:, None], c[:, None]):
            features += [scalar, torch.sin(scalar * self.frequencies), torch.cos(scalar * self.frequencies)]
        return self.layers(torch.cat(features, dim=1))[:, None]

    def bind(self, labels: Tensor) -> VelocityField:
        """The field under the labels (N,) of the points that it will be asked about, c = k / 7."""
        c = labels / (CLASSES - 1)
        return lambda x, t: self(x, t, c)


def train(steps: int, seed: int, batch: int = 512, rate: float = 2e-3) -> ConditionalFlow:
    """Train a flow on `steps` fresh batches and return its exponential moving average."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    flow = ConditionalFlow()
    average = AveragedModel(flow, avg_fn=_moving_average)
    optimizer = torch.optim.AdamW(flow.parameters(), lr=rate, weight_decay=0.0)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        labels = torch.randint(CLASSES, (batch,), generator=generator)
        chunks = sample_cells(labels, generator)[:, None]
        loss = flow_matching_loss(flow.bind(labels), chunks, generator=generator).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        average.update_parameters(flow)
    return average.module.eval().requires_grad_(False)


def _moving_average(average: Tensor, current: Tensor, count: Tensor) -> Tensor:
    """Decay 0.999, reached gradually so that the first weights are forgotten."""
    return average.lerp(current, 1 - min(0.999, (1 + int(count)) / (10 + int(count))))


@dataclass(frozen=True)
class Detector:
    """A flow and a score: nonconformity of points under a query label."""

    flow: ConditionalFlow
    score: ReverseScore

    def __call__(self, points: Tensor, labels: Tensor | int) -> Tensor:
        """Scores (N,) of points (N, 2) under labels (N,), or under one label."""
        labels = torch.as_tensor(labels).expand(len(points))
        return self.score(self.flow.bind(labels), points[:, None])

    def calibrate(self, seed: int, of: list[int] | None = None) -> ConformalGate:
        """The gate, from points with their true labels, of all classes or of those given."""
        labels = every_class(CALIBRATION_PER_CLASS, of)
        points = sample_cells(labels, torch.Generator().manual_seed(seed))
        return ConformalGate(self(points, labels), alpha=ALPHA)


def true_scores(detector: Detector, label: int, seed: int) -> Tensor:
    """Scores of test points of a class under their own label."""
    generator = torch.Generator().manual_seed(seed + label)
    return detector(sample_cells(every_class(TEST_PER_CLASS, [label]), generator), label)


def measure(detector: Detector, gate: ConformalGate, seed: int) -> list[dict[str, float]]:
    """One row per query label, on points that neither training nor calibration saw."""
    generator = torch.Generator().manual_seed(seed + CLASSES)
    rows = []
    for label in range(CLASSES):
        true = true_scores(detector, label, seed)
        outside = detector(sample_outside(label, TEST_PER_CLASS, generator), label)
        others = [other for other in range(CLASSES) if other != label]
        wrong = detector(sample_cells(every_class(TEST_PER_CLASS // len(others), others), generator), label)
        rows.append(
            {
                "label": label,
                "inside_accepted": gate.admits(true).double().mean().item(),
                "outside_accepted": gate.admits(outside).double().mean().item(),
                "wrong_class_auroc": auroc(true, wrong),
            }
        )
    return rows


def table(results: dict[int, list[dict[str, float]]]) -> str:
    """Markdown table: the mean over the query labels and, in brackets, the worst of them."""
    lines = [
        "| reverse steps | inside, accepted (least) | outside, accepted (most) | wrong-class AUROC (least) |",
        "|---|---|---|---|",
    ]
    for steps, rows in results.items():
        inside, outside, areas = (
            [row[key] for row in rows] for key in ("inside_accepted", "outside_accepted", "wrong_class_auroc")
        )
        lines.append(
            f"| {steps} | {100 * sum(inside) / CLASSES:.1f} % ({100 * min(inside):.1f} %) "
            f"| {100 * sum(outside) / CLASSES:.2f} % ({100 * max(outside):.2f} %) "
            f"| {sum(areas) / CLASSES:.5f} ({min(areas):.5f}) |"
        )
    return "\n".join(lines)


def p_value_map(detector: Detector, gate: ConformalGate, label: int) -> Tensor:
    """p-values of the points of `figures.GRID` under a query label, shape (G, G), rows along y."""
    axis = torch.from_numpy(figures.GRID).float()
    points = torch.cartesian_prod(axis, axis).flip(1)
    return gate.p_value(detector(points, label)).view(len(axis), len(axis))


def partial_coverage(detector: Detector, query: int, calibration_seed: int, test_seed: int) -> list[figures.Coverage]:
    """Query one class under a gate calibrated on classes 0 to k - 1, for every k."""
    true = true_scores(detector, query, test_seed)
    coverages = []
    for classes in range(1, CLASSES + 1):
        gate = detector.calibrate(calibration_seed, list(range(classes)))
        coverages.append(
            figures.Coverage(
                classes=classes,
                p_values=p_value_map(detector, gate, query).numpy(),
                accepted=gate.admits(true).double().mean().item(),
                calibration_scores=gate.scores.numpy(),
                query_scores=true.numpy(),
                threshold=gate.threshold,
            )
        )
    return coverages


def main() -> None:
    """Train, measure, print, draw."""
    parser = argparse.ArgumentParser(description="Out-of-distribution detection on a checkerboard.")
    parser.add_argument("--output", type=Path, default=Path("outputs/checkerboard"), help="results folder")
    parser.add_argument("--steps", type=int, default=15_000, help="training steps")
    parser.add_argument("--seed", type=int, default=0, help="of training; the data's seeds follow from it")
    arguments = parser.parse_args()
    # Training, calibration and test never share a generator.
    calibration_seed, test_seed = 100 * arguments.seed + 1001, 100 * arguments.seed + 1002
    arguments.output.mkdir(parents=True, exist_ok=True)

    torch.set_num_threads(1)
    begun = time.perf_counter()
    flow = train(arguments.steps, arguments.seed)
    print(f"trained {arguments.steps} steps in {time.perf_counter() - begun:.0f} s\n")

    results = {}
    for steps in REVERSE_STEPS:
        detector = Detector(flow, ReverseScore(steps=steps))
        gate = detector.calibrate(calibration_seed)
        results[steps] = measure(detector, gate, test_seed)
    print(table(results))

    # The figures show the last of them, the paper's five steps.
    maps = [p_value_map(detector, gate, label).numpy() for label in range(CLASSES)]
    query = CLASSES - 1
    coverages = partial_coverage(detector, query, calibration_seed, test_seed)
    generator = torch.Generator().manual_seed(test_seed)
    wrong = [
        detector(sample_cells(every_class(TEST_PER_CLASS, [label]), generator), query).numpy()
        for label in range(CLASSES)
        if label != query
    ]
    labels = every_class(600)
    training_points = sample_cells(labels, torch.Generator().manual_seed(arguments.seed))
    figures.training_distribution(training_points.numpy(), labels.numpy(), arguments.output)
    figures.accepted_regions(maps, results[steps], ALPHA, arguments.output)
    figures.partial_coverage(coverages, ALPHA, arguments.output)
    figures.id_histograms(coverages, arguments.output)
    figures.ood_histograms(coverages[-1], wrong, arguments.output)

    record = {
        "alpha": ALPHA,
        "seed": arguments.seed,
        "training_steps": arguments.steps,
        "calibration_points": CALIBRATION_PER_CLASS * CLASSES,
        "test_points_per_label": TEST_PER_CLASS,
        "rows": [{"reverse_steps": steps, **row} for steps, rows in results.items() for row in rows],
        "partial_coverage": [{"classes": one.classes, "inside_accepted": one.accepted} for one in coverages],
    }
    (arguments.output / "rows.json").write_text(json.dumps(record, indent=2) + "\n")
    print(f"\nrows.json and five figures are in {arguments.output}")


if __name__ == "__main__":
    main()
