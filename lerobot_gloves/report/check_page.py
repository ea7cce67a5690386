"""What a check of an adapter found, as a picture, and as one HTML page that needs nothing but itself."""

import math
from html import escape
from typing import Literal

import matplotlib
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lerobot_gloves.checkpoints.checked import Checked
from lerobot_gloves.checkpoints.telling import AGENT, BESIDE, CLEAN, KINDS
from lerobot_gloves.conformal import auroc
from lerobot_gloves.report.check_tables import ALPHAS, check_tables, values_at
from lerobot_gloves.report.html_page import document, figure_html, table_html
from lerobot_gloves.report.plots import EDITED, INK, LEFT, STYLE

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
AGENTS = "#3f8fe0"
LINES: tuple[Literal["-", "--", ":"], ...] = ("-", "--", ":")
"""Of the thresholds, an alpha each."""
CAPTION = (
    "Scores of the expert's held-out chunks and of the same gone wrong: boxes hold half of the chunks, whiskers nine "
    "tenths; upright lines are the thresholds of a gate, and what lies right of one is turned away. On the right the "
    "area under the ROC curve against the expert's: 0.5 is chance"
)


def check_page(checked: Checked) -> str:
    """The page: verdict, losses, picture and tables."""
    chunks = checked.chunks
    count, episodes = len(chunks.episode), len(chunks.episode.unique())
    facts = [f"{count} chunks of {episodes} episodes of {checked.data}", checked.loss_line]
    parts = [
        f"<h1>gloves check</h1>\n<p>{escape(checked.adapter)}</p>",
        f"<p><strong>{escape(checked.line)}</strong></p>",
        *(f"<p>{escape(fact)}</p>" for fact in facts if fact),
        figure_html(CAPTION, check_plot(checked)),
        *map(table_html, check_tables(checked)),
    ]
    return document("gloves check", parts)


def check_plot(checked: Checked) -> Figure:
    """A panel a score: how the scores of each kind are distributed, and the thresholds."""
    chunks = checked.chunks
    kinds = [CLEAN, *KINDS, *([AGENT] if checked.proposals else [])]
    with matplotlib.rc_context(STYLE):
        panels = len(chunks.scores)
        figure = Figure(figsize=(10, panels * (0.6 + 0.3 * len(kinds)) + 0.4), layout="constrained")
        column = figure.subplots(panels, 1, squeeze=False)[:, 0]
        for axes, name in zip(column, chunks.scores, strict=True):
            _panel(axes, checked, name, kinds)
        handles = [
            Line2D([], [], color=INK, linestyle=line, linewidth=1, label=f"threshold of alpha {alpha:g}")
            for alpha, line in zip(ALPHAS, LINES, strict=True)
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _panel(axes: Axes, checked: Checked, name: str, kinds: list[str]) -> None:
    chunks = checked.chunks
    scores = {**chunks.scores[name], AGENT: checked.proposals.get(name, torch.empty(0))}
    found = {kind: values_at(scores[kind], QUANTILES) for kind in kinds}
    finite = [value for row in found.values() for value in row if math.isfinite(value)]
    if min(finite) > 0 and max(finite) > 10 * min(finite):
        axes.set_xscale("log")
    # What scores infinite is drawn at the edge, and said to be.
    edge = max(finite) * (3 if axes.get_xscale() == "log" else 1) + (0.0 if axes.get_xscale() == "log" else 1.0)
    for place, kind in enumerate(kinds):
        if not found[kind]:  # such as replays, in data of episodes that are too short for any
            continue
        low, first, median, third, high = (min(value, edge) for value in found[kind])
        colour = {CLEAN: LEFT, AGENT: AGENTS}.get(kind, EDITED)
        axes.plot([low, high], [place, place], color=colour, linewidth=1.5, solid_capstyle="butt")
        axes.barh(place, third - first, left=first, height=0.56, color=colour)
        axes.plot([median, median], [place - 0.28, place + 0.28], color=INK, linewidth=1.5)
        area = "area" if kind == CLEAN else f"{auroc(scores[BESIDE if kind == AGENT else CLEAN], scores[kind]):.2f}"
        beyond = ", infinite" if math.isinf(found[kind][2]) else ""
        axes.annotate(area + beyond, (1.01, place), xycoords=("axes fraction", "data"), va="center")
    for alpha, line in zip(ALPHAS, LINES, strict=True):
        threshold = chunks.threshold(name, alpha)
        if math.isfinite(threshold):
            axes.axvline(threshold, color=INK, linestyle=line, linewidth=1)
    labels = {CLEAN: "expert's", AGENT: "your agent's"}
    axes.set_yticks(range(len(kinds)), [labels.get(kind, kind) for kind in kinds])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    axes.set_xlabel(name)
