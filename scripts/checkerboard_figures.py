"""The five figures of the checkerboard toy, drawn from arrays: `checkerboard.py` makes those."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

# Lower left corner of every class's cell; numbered row by row, so that 5 touches 7 and 0 is farthest from it.
CORNERS = [(x, y) for y in range(-2, 2) for x in range(-2, 2) if (x + y) % 2 == 0]
GRID = np.linspace(-2.25, 2.25, 226)
"""Coordinates of the maps' points along either axis; they reach a little past the square."""

INK, MUTED, TEAL, NAVY, ORANGE, BLUE = (
    "#22313f", "#8a97a3", "#2a9d8f", "#123047", "#e76f51", "#2f6fde",
)  # fmt: skip
CLASS_COLOURS = ("#3d5a98", "#4f9bc4", "#2a9d8f", "#8ab17d", "#c9a227", "#f4a261", "#e76f51", "#a23b72")
P_VALUES = LinearSegmentedColormap.from_list("p", ["#ffffff", "#d3ece7", "#7cc6b8", TEAL, "#176d74", NAVY])

plt.rcParams.update(
    {
        "font.size": 9,
        "text.color": INK,
        "axes.labelcolor": INK,
        "axes.edgecolor": MUTED,
        "axes.linewidth": 0.8,
        "axes.titlesize": 9.5,
        "xtick.color": INK,
        "ytick.color": INK,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "legend.frameon": False,
        "savefig.dpi": 160,
    }
)


@dataclass
class Coverage:
    """The last class queried under a gate that was calibrated on classes 0 to `classes` - 1.

    Attributes:
        classes: How many classes the calibration covers.
        p_values: Over `GRID` x `GRID`, rows along y.
        accepted: Share of the query's true points that the gate admits.
        calibration_scores: Scores of the calibration points.
        query_scores: Scores of the query's true points.
        threshold: The gate's.
    """

    classes: int
    p_values: np.ndarray
    accepted: float
    calibration_scores: np.ndarray
    query_scores: np.ndarray
    threshold: float

    @property
    def title(self) -> str:
        """Which classes are covered, in words."""
        if self.classes == 1:
            return "calibrated on class 0"
        return f"calibrated on classes 0–{self.classes - 1}"

    @property
    def covers_query(self) -> bool:
        """Whether the queried class itself is among the calibration points."""
        return self.classes == len(CORNERS)


def training_distribution(points: np.ndarray, labels: np.ndarray, folder: Path) -> None:
    """Figure 1: the eight classes, points (N, 2) with labels (N,)."""
    figure, axes = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
    _square(axes)
    for label, (x, y) in enumerate(CORNERS):
        axes.add_patch(Rectangle((x, y), 1, 1, color=CLASS_COLOURS[label], alpha=0.12, lw=0))
        cell = points[labels == label]
        axes.scatter(*cell.T, s=3, color=CLASS_COLOURS[label], lw=0, alpha=0.75)
        bubble = {"boxstyle": "circle,pad=0.28", "fc": "white", "ec": CLASS_COLOURS[label], "lw": 1.2}
        axes.text(x + 0.5, y + 0.5, str(label), ha="center", va="center", weight="bold", bbox=bubble)
    axes.set(title="Eight classes on a checkerboard", xlabel="$x_1$", ylabel="$x_2$")
    _save(figure, folder, "1_training_distribution")


def accepted_regions(maps: list[np.ndarray], rows: list[dict[str, float]], alpha: float, folder: Path) -> None:
    """Figure 2: where p > alpha under each label; p-value maps, and the rows of `checkerboard.measure`."""
    figure, panels = _panels("Accepted region under every query label", height=6.6)
    for label, (axes, p_values) in enumerate(zip(panels, maps, strict=True)):
        _square(axes)
        _cells(axes, label)
        axes.contourf(GRID, GRID, p_values, levels=[alpha, 1.1], colors=[TEAL], alpha=0.75)
        axes.contour(GRID, GRID, p_values, levels=[alpha], colors=[NAVY], linewidths=1.0)
        inside, outside = (100 * rows[label][key] for key in ("inside_accepted", "outside_accepted"))
        axes.set_title(f"$c = {label}/7$", weight="bold")
        axes.set_xlabel(f"inside {inside:.1f} %,  outside {outside:.2f} %", color=INK, size=8)
    handles = [
        Rectangle((0, 0), 1, 1, fc=TEAL, ec=NAVY, alpha=0.75, label=f"accepted, $p > {alpha:g}$"),
        Rectangle((0, 0), 1, 1, fill=False, ec=ORANGE, ls="--", lw=1.4, label="queried cell"),
        Rectangle((0, 0), 1, 1, fc="#dfe4e8", lw=0, label="cells of the other classes"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    _save(figure, folder, "2_accepted_regions")


def partial_coverage(coverages: list[Coverage], alpha: float, folder: Path) -> None:
    """Figure 3: p-values under the last label, the calibration covering more and more classes."""
    figure, panels = _panels("Query class 7, calibrated on ever more classes", height=6.1)
    for axes, coverage in zip(panels, coverages, strict=True):
        _square(axes)
        image = axes.pcolormesh(
            GRID, GRID, coverage.p_values, cmap=P_VALUES, vmin=0, vmax=1, shading="gouraud", rasterized=True
        )
        axes.contour(GRID, GRID, coverage.p_values, levels=[alpha], colors=[ORANGE], linewidths=1.1)
        for label, (x, y) in enumerate(CORNERS):
            axes.add_patch(Rectangle((x, y), 1, 1, fill=False, ec="#dfe4e8", lw=0.8))
            known = label < coverage.classes
            axes.text(
                x + 0.5, y + 0.5, str(label), ha="center", va="center", size=8,
                color="white" if label == len(CORNERS) - 1 else INK if known else "#c3cad0",
                weight="bold" if known else "normal",
            )  # fmt: skip
        if not coverage.covers_query:
            for spine in axes.spines.values():
                spine.set(color=BLUE, linewidth=2.2)
        axes.set_title(coverage.title)
        axes.set_xlabel(f"class-7 cell: {100 * coverage.accepted:.1f} % accepted", size=8)
    bar = figure.colorbar(image, ax=panels, shrink=0.85, pad=0.015, label="conformal $p$-value")
    bar.ax.axhline(alpha, color=ORANGE, lw=1.6)
    bar.outline.set_visible(False)
    notes = ["blue border: class 7 is absent from calibration", f"orange: $p = {alpha:g}$", "bold: in calibration"]
    figure.supxlabel((8 * " ").join(notes), size=8.5)
    _save(figure, folder, "3_partial_coverage")


def id_histograms(coverages: list[Coverage], folder: Path) -> None:
    """Figure 4: scores of the calibration points and of the query's true points."""
    figure, panels = _panels("Calibration scores and true class-7 scores", height=4.9)
    highest = 1.8 * max(coverage.threshold for coverage in coverages)
    bins = np.linspace(0, highest, 28)
    for axes, coverage in zip(panels, coverages, strict=True):
        _histogram(axes, coverage.calibration_scores, bins, MUTED, filled=True, label="calibration points")
        _histogram(axes, coverage.query_scores, bins, CLASS_COLOURS[7], label="true class-7 points")
        _threshold(axes, coverage.threshold)
        axes.set_title(coverage.title, color=INK if coverage.covers_query else BLUE)
        axes.set(xlim=(0, highest), xlabel=r"score $\|\hat z\|^2$", yticks=[])
    panels[0].set_ylabel("share of points")
    panels[4].set_ylabel("share of points")
    _equal_heights(panels)
    handles, _ = panels[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    _save(figure, folder, "4_id_histograms")


def ood_histograms(coverage: Coverage, wrong: list[np.ndarray], folder: Path) -> None:
    """Figure 5: scores of every other class's points under the last label, nearest class first."""
    figure, panels = _panels("Points of other classes under the label of class 7", height=4.9)
    query = np.array(CORNERS[-1])
    distances = [float(np.linalg.norm(np.array(corner) - query)) for corner in CORNERS[:-1]]
    low = min(np.quantile(coverage.query_scores, 0.01), 0.05)
    bins = np.geomspace(low, 1.3 * max(scores.max() for scores in wrong), 60)
    for axes, label in zip(panels, np.argsort(distances, kind="stable"), strict=False):
        _histogram(axes, coverage.calibration_scores, bins, MUTED, filled=True, label="calibration points")
        _histogram(axes, coverage.query_scores, bins, CLASS_COLOURS[7], label="true class-7 points")
        _histogram(axes, wrong[label], bins, CLASS_COLOURS[label], filled=True)
        _threshold(axes, coverage.threshold)
        rejected = 100 * float((wrong[label] > coverage.threshold).mean())
        axes.set_title(f"class {label}, distance {distances[label]:.1f}: {rejected:.1f} % rejected", size=8.5)
        axes.set(xscale="log", xlim=(bins[0], bins[-1]), xlabel=r"score $\|\hat z\|^2$", yticks=[])
    panels[0].set_ylabel("share of points")
    panels[4].set_ylabel("share of points")
    _equal_heights(panels[:7])
    _square(panels[7])
    for label, (x, y) in enumerate(CORNERS):
        panels[7].add_patch(Rectangle((x, y), 1, 1, color=CLASS_COLOURS[label], alpha=0.85, lw=0))
        panels[7].text(x + 0.5, y + 0.5, str(label), ha="center", va="center", color="white", weight="bold")
    panels[7].set_title("where the classes lie", size=8.5)
    handles, _ = panels[0].get_legend_handles_labels()
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    _save(figure, folder, "5_ood_histograms")


def _panels(title: str, height: float) -> tuple[Figure, np.ndarray]:
    figure, panels = plt.subplots(2, 4, figsize=(10.4, height), layout="constrained")
    figure.suptitle(title, weight="bold", size=11.5)
    figure.get_layout_engine().set(hspace=0.04, h_pad=0.06)
    return figure, panels.ravel()


def _square(axes: Axes) -> None:
    axes.set(xlim=(GRID[0], GRID[-1]), ylim=(GRID[0], GRID[-1]), xticks=range(-2, 3), yticks=range(-2, 3))
    axes.set_aspect("equal")
    axes.tick_params(length=2)


def _cells(axes: Axes, query: int) -> None:
    for label, corner in enumerate(CORNERS):
        if label == query:
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, ec=ORANGE, ls="--", lw=1.4, zorder=4))
        else:
            axes.add_patch(Rectangle(corner, 1, 1, fc="#dfe4e8", lw=0))


def _histogram(
    axes: Axes, scores: np.ndarray, bins: np.ndarray, colour: str, filled: bool = False, **options: Any
) -> None:
    kind = "stepfilled" if filled else "step"
    weights = np.full(len(scores), 1 / len(scores))
    style = {"alpha": 0.5, "lw": 0} if filled else {"lw": 1.5}
    axes.hist(scores, bins, weights=weights, histtype=kind, color=colour, **style, **options)


def _threshold(axes: Axes, threshold: float) -> None:
    axes.axvline(threshold, color=INK, lw=1.0, ls=":", label=r"threshold $\tau$")
    axes.spines[["top", "right", "left"]].set_visible(False)


def _equal_heights(panels: np.ndarray) -> None:
    highest = max(axes.get_ylim()[1] for axes in panels)
    for axes in panels:
        axes.set_ylim(0, highest)


def _save(figure: Figure, folder: Path, name: str) -> None:
    figure.savefig(folder / f"{name}.png")
    plt.close(figure)
