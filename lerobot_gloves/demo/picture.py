"""The picture: raw and corrected paths through the pillars, seen from above."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from lerobot_gloves.demo.replay import Path2d
from lerobot_gloves.tasks.slalom.scene import GOAL_Y, PILLAR_RADII, PILLARS, START

SUCCESS, FAILURE, INK, FAINT = "#1f77b4", "#d9480f", "#22272e", "#868e96"
ENDS = {"collision": ("x", "touched a pillar"), "wrong_corridor": ("o", "wrong gap"), "timeout": ("s", "too slow")}
"""Marker where a path ends, and what it means, by the environment's word for the failure."""


def draw(panels: Mapping[str, Sequence[Path2d]], title: str) -> Figure:
    """A panel for each method, all over the same axes.

    The goal lies to the right, and x grows downward, as the robot's camera sees it.

    Args:
        panels: Paths by the method's label.
        title: Above them.
    """
    width, height = 6.2 * len(panels), 6.3
    figure = Figure(figsize=(width, height), dpi=150)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    figure.subplots_adjust(
        left=0.7 / width, right=1 - 0.25 / width, top=1 - 1.0 / height, bottom=1.0 / height, wspace=0.04
    )
    for panel, (label, paths) in zip(axes, panels.items(), strict=True):
        reached = sum(not path.failure for path in paths)
        panel.set_title(
            f"{label}: {reached} of {len(paths)} succeed", loc="left", fontsize=15, color=INK, weight="bold"
        )
        _scene(panel)
        for path in sorted(paths, key=lambda one: one.failure == ""):  # failures below, where they hide nothing
            _path(panel, path)
    axes[0].set_ylabel("x in metres", fontsize=12, color=INK)
    figure.text(0.7 / width, 1 - 0.3 / height, title, fontsize=13, color=INK, va="center")
    failures = {path.failure for paths in panels.values() for path in paths if path.failure}
    handles = [Line2D([], [], color=SUCCESS, lw=2.5, label="through the requested corridor")]
    for failure in sorted(failures):
        marker, meaning = _end(failure)
        handles.append(Line2D([], [], color=FAILURE, lw=2.5, marker=marker, ms=8, mew=2, mfc="none", label=meaning))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=12)
    return figure


def _scene(panel: Axes) -> None:
    for (x, y), radius in zip(PILLARS, PILLAR_RADII, strict=True):
        panel.add_patch(Circle((y, x), radius, facecolor="#ced4da", edgecolor=FAINT, lw=1.2, zorder=4))
    panel.axvline(GOAL_Y, color="#2f9e44", lw=4, zorder=1)
    panel.plot(START[1], START[0], "o", ms=9, color=INK, zorder=7)
    halo = [withStroke(linewidth=4, foreground="white")]
    for word, (x, y), colour in (("goal", (0.235, GOAL_Y - 0.012), "#2f9e44"), ("start", (0.475, START[1]), INK)):
        side = "right" if word == "goal" else "center"
        panel.text(
            y, x, word, color=colour, fontsize=13, weight="bold", ha=side, va="center", path_effects=halo, zorder=8
        )
    panel.set(xlim=(-0.37, 0.40), ylim=(0.79, 0.21), aspect="equal")
    panel.set_xlabel("y in metres", fontsize=12, color=INK)
    panel.tick_params(labelsize=11, colors=FAINT, length=0)
    panel.grid(color="#f1f3f5", zorder=0)
    panel.set_axisbelow(True)
    for spine in panel.spines.values():
        spine.set_visible(False)


def _path(panel: Axes, path: Path2d) -> None:
    colour = FAILURE if path.failure else SUCCESS
    x, y = np.transpose(path.tips)
    panel.plot(y, x, color=colour, lw=1.1, alpha=0.55, zorder=2, solid_capstyle="round")
    if path.failure:
        marker, _ = _end(path.failure)
        panel.plot(y[-1], x[-1], marker, ms=5.5, mew=1.4, mfc="none", color=colour, zorder=6)


def _end(failure: str) -> tuple[str, str]:
    return ENDS.get(failure, ("d", failure))
