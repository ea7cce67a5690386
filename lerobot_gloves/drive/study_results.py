"""What came of a study: its table and the picture of all paths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import matplotlib
import numpy as np
from lerobot.utils.constants import ACTION
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from lerobot_gloves.drive.study_folder import ASSISTED, COMMANDED, EDITED
from lerobot_gloves.drive.view import View
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.report.clusters import sign_flip
from lerobot_gloves.report.plots import STYLE
from lerobot_gloves.report.statistics import paired_difference, wilson
from lerobot_gloves.report.tables import MISSING, Entry, Table

CONDITIONS = {False: "without assistance", True: "with assistance"}
SUCCESS, FAILURE, RULE = "#2a9d6f", "#d05050", "#8a8a8a"
CAPTION = (
    "Success in % [95 % Wilson interval]; seconds of the successful episodes; commands: how often one changed, in an "
    "episode; edited: share of the steps. Difference: in the same corridors [95 % interval, Newcombe's for pairs], p "
    "of the exact sign-flip test, which for success is McNemar's; of seconds, where both succeeded."
)


@dataclass(frozen=True)
class Driven:
    """An episode of a study.

    Attributes:
        seed: Of its environment.
        assisted: Whether the person was helped.
        success: Whether it succeeded.
        steps: How many it took.
        commands: How often the command changed to another that is not to stand still.
        edited: Share of its steps at which the command was changed.
        path: Where what is steered was, (right, down) in metres, at each step.
    """

    seed: int
    assisted: bool
    success: bool
    steps: int
    commands: int
    edited: float
    path: list[tuple[float, float]]


def driven(
    seed: int,
    episode: StagedEpisode,
    place: Callable[[dict[str, Any]], tuple[float, float]],
    arrow: Callable[[np.ndarray], tuple[float, float, float]],
) -> Driven:
    """What a study's table says of an episode.

    Args:
        seed: Of its environment.
        episode: What is kept of it.
        place: From the frame of a step, under a dataset's keys, to where what is steered is.
        arrow: From an action (A,) to where the stick would be for it, zero for standing still.
    """
    frames = episode.frames
    commanded = np.array([arrow(command) for command in frames[COMMANDED]])
    before = np.vstack([np.zeros_like(commanded[:1]), commanded[:-1]])
    return Driven(
        seed,
        bool(frames[ASSISTED][0, 0]),
        not episode.failure,
        len(frames[ACTION]),
        int(((commanded != before).any(axis=1) & commanded.any(axis=1)).sum()),
        float(frames[EDITED].mean()),
        [place({key: values[step] for key, values in frames.items()}) for step in range(len(commanded))],
    )


def study_table(episodes: Sequence[Driven], rate: float) -> Table:
    """Without beside with assistance, and the difference in the same corridors.

    Args:
        episodes: Each corridor once without and once with assistance.
        rate: Steps a second.
    """
    by = {(one.seed, one.assisted): one for one in episodes}
    pairs = [(by[seed, False], by[seed, True]) for seed in sorted({one.seed for one in episodes})]
    lines = []
    for assisted, name in CONDITIONS.items():
        mine = [pair[assisted] for pair in pairs]
        successes = [one for one in mine if one.success]
        low, high = (100 * end for end in wilson(len(successes), len(mine)))
        share = 100 * len(successes) / len(mine)
        lines.append(
            [
                name,
                f"{len(successes)} of {len(mine)}: {share:.0f}\n[{low:.0f}, {high:.0f}]",
                f"{fmean(one.steps for one in successes) / rate:.1f}" if successes else MISSING,
                f"{fmean(one.commands for one in mine):.1f}",
                f"{100 * fmean(one.edited for one in mine):.0f} %",
            ]
        )
    found = paired_difference([raw.success for raw, _ in pairs], [helped.success for _, helped in pairs])
    both = [(raw, helped) for raw, helped in pairs if raw.success and helped.success]
    lines.append(
        [
            "difference",
            f"{100 * found.mean:+.0f}\n[{100 * found.low:+.0f}, {100 * found.high:+.0f}],\n{_p(found.p_value)}",
            _difference([helped.steps - raw.steps for raw, helped in both], 1 / rate),
            _difference([helped.commands - raw.commands for raw, helped in pairs], 1),
            MISSING,
        ]
    )
    header = ["", "success", "seconds", "commands", "edited"]
    return Table(CAPTION, header, [[Entry(text) for text in line] for line in lines])


def paths_figure(episodes: Sequence[Driven], view: View) -> Figure:
    """The ways of all episodes on the top view, without assistance and with it."""
    left, above, right, below = view.scene["bounds"]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8, 8 * 0.55 * (below - above) / (right - left) + 0.5), layout="constrained")
        for axes, (assisted, name) in zip(figure.subplots(1, 2), CONDITIONS.items(), strict=True):
            mine = [one for one in episodes if one.assisted == assisted]
            axes.set_title(f"{name}: {sum(one.success for one in mine)} of {len(mine)} succeeded")
            for x, y, radius in view.scene["circles"]:
                axes.add_patch(Circle((x, y), radius, color=RULE, lw=0))
            for line in view.scene["lines"]:
                axes.plot(*zip(line["from"], line["to"], strict=True), color=RULE, lw=1)
            for one in mine:
                # A dashed way is told apart without colours.
                colour, dash = (SUCCESS, "-") if one.success else (FAILURE, "--")
                axes.plot(*zip(*one.path, strict=True), color=colour, ls=dash, lw=1.2, alpha=0.8)
            axes.set(xlim=(left, right), ylim=(below, above), aspect="equal", xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
    return figure


def _difference(found: Sequence[int], unit: float) -> str:
    if not found:
        return MISSING
    return f"{fmean(found) * unit:+.1f},\n{_p(sign_flip(found, range(len(found))))}"


def _p(value: float) -> str:
    return f"p = {value:.3f}" if value >= 0.001 else "p < 0.001"
