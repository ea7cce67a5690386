"""Plots of a report, as figures of matplotlib.

Colours are of middling lightness, and everything that is not data is drawn in `INK`, which the page replaces by its own
text colour: the same picture serves light and dark screens.
"""

from collections.abc import Sequence
from math import ceil
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lerobot_gloves.evaluation.histogram import SCALE, edge
from lerobot_gloves.report.overall import Overall
from lerobot_gloves.report.paper import COLUMNS
from lerobot_gloves.report.summary import Result, Section
from lerobot_gloves.report.tables import comparable
from lerobot_gloves.specification import parts_of

INK = "#0a0b0c"
"""Drawn nowhere else, so that a page can find it."""
GATED, UNGATED = "s", "o"
COLOURS = ("#8a8a8a", "#a06cd5", "#c2698b", "#2a9d6f", "#e07b1f", "#e07b1f", "#3f8fe0", "#3f8fe0")
"""Of the paper's methods: a colour an editor; gated ones are told apart by their marker."""
OTHER_COLOURS = ("#d05050", "#4aa5a5", "#b0902f", "#7d7fd8", "#6fa03c", "#cf6fc4", "#9c7a5b", "#5f8aa8")
COLUMNS_BESIDE = 5
MOST_METHODS = 12
"""More, as a search has them, could not be told apart."""
LEFT, EDITED = "#aab4c2", "#a8323e"
"""Of chunks; no method has one of these."""
STYLE: Any = {
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": INK,
    "grid.alpha": 0.15,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "gloves",
}


def plots(section: Section, *, paper: bool = False) -> dict[str, Figure]:
    """A section's plots, by their captions.

    Args:
        section: What to plot.
        paper: Whether the paper's figures are plotted besides, where its perturbation has the same strength.

    Returns:
        The plots; none of a section with more than `MOST_METHODS` methods.
    """
    if len(section.methods) > MOST_METHODS:
        return {}
    with matplotlib.rc_context(STYLE):
        made = {"Success per cell, with the table's 95 % intervals": success_plot(section, paper=paper)}
        if any(result.chunks for result in section.results.values()):
            made["Fidelity against success: distance of executed from proposed actions, one panel a perturbation"] = (
                fidelity_plot(section)
            )
        if any(result.scores_left or result.scores_edited for result in section.results.values()):
            made["Nonconformity scores of the chunks that the gate left and of those that were edited"] = score_plot(
                section
            )
    return made


def success_plot(section: Section, *, paper: bool) -> Figure:
    """Success of every method, perturbations side by side."""
    names, perturbations = list(section.methods), list(section.perturbations)
    theirs = comparable(section) if paper else {}
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots()
    step = 0.8 / max(len(names), 1)
    for place, name in enumerate(names):
        for line, perturbation in enumerate(perturbations):
            x = line + step * (place - (len(names) - 1) / 2)
            if result := section.results.get((perturbation, name)):
                _point(axes, x, result, name, names)
            figures = theirs.get(section.perturbations[perturbation], {})
            if name in figures:
                axes.plot(x, 100 * figures[name].mean, marker="x", color=_colour(name, names), markersize=6)
    for line in range(len(perturbations) - 1):
        axes.axvline(line + 0.5, color=INK, alpha=0.2, linewidth=0.8)
    axes.set_xticks(range(len(perturbations)), [_wrapped(name) for name in perturbations])
    axes.set_xlim(-0.5, len(perturbations) - 0.5)
    _percent(axes)
    axes.set_ylabel("success, %")
    handles = _handles(names)
    if any(strength in theirs for strength in section.perturbations.values()):
        handles.append(Line2D([], [], linestyle="none", marker="x", color=INK, label="the paper's"))
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 9))
    return figure


def fidelity_plot(section: Section) -> Figure:
    """Success over distance; the raw agent lies at distance 0, its success is the dashed line."""
    names, perturbations = list(section.methods), list(section.perturbations)
    lines = ceil(len(perturbations) / COLUMNS_BESIDE)
    columns = ceil(len(perturbations) / lines)
    figure = Figure(figsize=(10, 2.6 * lines + 0.4), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
    for axes in panels[len(perturbations) :]:
        axes.set_axis_off()
    for place, (axes, perturbation) in enumerate(zip(panels, perturbations, strict=False)):
        for name in names:
            result = section.results.get((perturbation, name))
            if result is None:
                continue
            _point(axes, result.distance or 0.0, result, name, names)
            if name == section.raw:
                axes.axhline(100 * result.mean, color=_colour(name, names), linestyle="--", linewidth=0.8)
        axes.set_title(_wrapped(perturbation))
        axes.set_xlabel("mean distance, normalised")
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        _percent(axes)
        if place % columns == 0:
            axes.set_ylabel("success, %")
    handles = _handles(names)
    figure.legend(handles=handles, loc="outside upper center", ncols=min(len(handles), 9))
    return figure


def score_plot(section: Section) -> Figure:
    """Histograms of scores, one line a gated method and one column a perturbation; shares of all its chunks."""
    scored = {key: result for key, result in section.results.items() if result.scores_left or result.scores_edited}
    perturbations = [name for name in section.perturbations if any(name == key[0] for key in scored)]
    names = [name for name in section.methods if any(name == key[1] for key in scored)]
    numbers = [number for result in scored.values() for number in (*result.scores_left, *result.scores_edited)]
    edges = [edge(number) for number in range(min(numbers), max(numbers) + 2)]
    if edges[0] == 0.0:
        edges[0] = edges[1] / 2  # a logarithmic axis has no 0
    figure = Figure(figsize=(10, 1.9 * len(names) + 0.6), layout="constrained")
    grid = figure.subplots(len(names), len(perturbations), squeeze=False, sharex=True, sharey=True)
    for line, name in zip(grid, names, strict=True):
        line[0].set_ylabel(f"{name}\n% of chunks")
        for axes, perturbation in zip(line, perturbations, strict=True):
            if result := scored.get((perturbation, name)):
                _histogram(axes, result, range(min(numbers), max(numbers) + 1), edges)
    for axes, perturbation in zip(grid[0], perturbations, strict=True):
        axes.set_title(_wrapped(perturbation))
    for axes in grid[-1]:
        axes.set_xlabel("score")
    handles = [
        Line2D([], [], linestyle="none", marker="s", color=colour, label=label)
        for colour, label in ((LEFT, "left as proposed"), (EDITED, "edited"))
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def overall_plot(overall: Overall) -> Figure:
    """Every cell of a benchmark as a dot, a task a colour, and the mean of each method as a bar."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        axes = figure.subplots()
        colours = dict(zip([section.name for section in overall.sections], OTHER_COLOURS, strict=False))
        for place, method in enumerate(overall.methods):
            for index, ((section, _), result) in enumerate(zip(overall.cells, overall.results(method), strict=True)):
                x = place + 0.5 * (index / max(len(overall.cells) - 1, 1) - 0.5)
                axes.plot(x, 100 * result.mean, "o", color=colours[section.name], markersize=5)
            axes.plot([place - 0.35, place + 0.35], [overall.mean(method)] * 2, color=INK, linewidth=2)
            axes.text(place, -1, f"{overall.mean(method):.1f}", ha="center", va="bottom", weight="bold")
        axes.axhline(overall.mean(COLUMNS[0]), color=INK, alpha=0.4, linestyle="--", linewidth=0.8)
        axes.set_xticks(range(len(overall.methods)), overall.methods)
        _percent(axes)
        axes.set_ylabel("success, %")
        handles = [Line2D([], [], linestyle="none", marker="o", color=c, label=name) for name, c in colours.items()]
        handles.append(Line2D([], [], color=INK, linewidth=2, label=f"mean of {len(overall.cells)} cells"))
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _histogram(axes: Axes, result: Result, numbers: range, edges: Sequence[float]) -> None:
    total = sum(result.scores_left.values()) + sum(result.scores_edited.values())
    left = [100 * result.scores_left.get(number, 0) / total for number in numbers]
    both = [
        share + 100 * result.scores_edited.get(number, 0) / total for number, share in zip(numbers, left, strict=True)
    ]
    axes.stairs(left, edges, fill=True, color=LEFT)
    axes.stairs(both, edges, baseline=left, fill=True, color=EDITED)
    ticks = [10.0**power for power in range(-4, 16, 2)]
    if edges[0] > 0:
        axes.set_xscale("log")
    else:
        axes.set_xscale("asinh", linear_width=SCALE)
        large = [tick for tick in ticks if tick >= 1]
        ticks = [*(-tick for tick in reversed(large)), 0.0, *large]
    axes.set_xticks([tick for tick in ticks if edges[0] <= tick <= edges[-1]])
    axes.minorticks_off()


def _point(axes: Axes, x: float, result: Result, name: str, names: Sequence[str]) -> None:
    """A success rate with its interval. Its mean over seeds may lie beside the middle of all episodes, even outside."""
    mean = 100 * result.mean
    error = [[max(0.0, mean - 100 * result.low)], [max(0.0, 100 * result.high - mean)]]
    colour = _colour(name, names)
    axes.errorbar(
        x,
        mean,
        yerr=error,
        color=colour,
        marker=_marker(name),
        markersize=5,
        capsize=2,
        linewidth=1.2,
        linestyle="none",
    )


def _handles(names: Sequence[str]) -> list[Line2D]:
    return [
        Line2D([], [], linestyle="none", marker=_marker(name), color=_colour(name, names), label=name) for name in names
    ]


def _marker(name: str) -> str:
    return GATED if name.endswith("+gate") else UNGATED


def _colour(name: str, names: Sequence[str]) -> str:
    if name in COLUMNS:
        return COLOURS[COLUMNS.index(name)]
    others = [other for other in names if other not in COLUMNS]
    return OTHER_COLOURS[others.index(name) % len(OTHER_COLOURS)]


def _percent(axes: Axes) -> None:
    axes.set_ylim(-3, 103)
    axes.grid(axis="y")


def _wrapped(specification: str) -> str:
    """A perturbation's options below its name, so that neighbours do not run into each other."""
    words = [part.partition(":") for part in parts_of(specification)]
    return "\n+".join(f"{name}\n{options}" if options else name for name, _, options in words)
