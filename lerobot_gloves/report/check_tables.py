"""What a check of an adapter found, as tables, and as the text that is printed."""

import math
from collections.abc import Sequence

from torch import Tensor

from lerobot_gloves.checkpoints.checked import Checked
from lerobot_gloves.checkpoints.telling import BESIDE, KINDS
from lerobot_gloves.conformal import auroc
from lerobot_gloves.report.markdown import markdown
from lerobot_gloves.report.tables import MISSING, Entry, Table

ALPHAS = (0.01, 0.05, 0.1)
QUANTILES = (0.1, 0.5, 0.9)


def check_text(checked: Checked) -> str:
    """The page of Markdown that `gloves check` prints, but for the verdict."""
    parts = [checked.loss_line, *map(markdown, check_tables(checked))]
    return "\n\n".join(part for part in parts if part)


def check_card(checked: Checked) -> str:
    """What a model card says of a check."""
    count = f"On {len(checked.chunks.episode)} chunks of {len(checked.chunks.episode.unique())} episodes"
    parts = [f"{count} of `{checked.data}`: {checked.line}.", checked.loss_line, markdown(areas(checked))]
    return "\n\n".join(part for part in parts if part)


def check_tables(checked: Checked) -> list[Table]:
    """All tables of a check: areas, gates, regions, and the agent's if there is one."""
    return [areas(checked), gates(checked), by_region(checked), *([of_agent(checked)] if checked.proposals else [])]


def areas(checked: Checked) -> Table:
    """How well each score tells each kind."""
    chunks = checked.chunks
    caption = "Area under the ROC curve between clean chunks and others [95 % interval]"
    if all(of["replayed"].isnan().all() for of in chunks.scores.values()):
        caption += "; no episode is as long as two chunks, so that nothing can be replayed"
    return Table(
        f"{caption}:",
        ["score", *KINDS],
        [_line(name, *(_area(*chunks.area(name, kind)) for kind in KINDS)) for name in chunks.scores],
    )


def gates(checked: Checked) -> Table:
    """Thresholds, and what a gate with each turns away."""
    chunks = checked.chunks
    return Table(
        "Turned away by a gate that was calibrated on the clean chunks:",
        ["score", "alpha", "threshold", *KINDS],
        [
            _line(
                name,
                f"{alpha:g}",
                _number(chunks.threshold(name, alpha)),
                *(_percent(chunks.stopped(name, kind, alpha)) for kind in KINDS),
            )
            for name in chunks.scores
            for alpha in ALPHAS
        ],
    )


def by_region(checked: Checked) -> Table:
    """How often a gate would stop the expert, here and there."""
    chunks, wide = checked.chunks, ALPHAS[1:]
    stopped = [(name, alpha, chunks.p_values(name) <= alpha) for name in chunks.scores for alpha in wide]
    lines = [
        _line(
            region.name,
            str(int(region.members.sum())),
            *(_percent(found[region.members].double().mean().item()) for _, _, found in stopped),
        )
        for region in checked.regions
    ]
    lines.append(_line("all", str(len(chunks.episode)), *(_percent(one.double().mean().item()) for *_, one in stopped)))
    caption = (
        "The expert's own chunks that would be turned away, each by a gate calibrated on the other episodes, by where "
        "they begin: in which third of an episode, and in which region of the robot's state (observation.state, which "
        "k-means divides; a range holds nine tenths of a region's chunks):"
    )
    return Table(caption, ["where", "chunks", *(f"{name}, alpha {alpha:g}" for name, alpha, _ in stopped)], lines)


def of_agent(checked: Checked) -> Table:
    """An agent's proposals beside the expert's chunks of as many actions."""
    chunks, lines = checked.chunks, []
    for name, proposals in checked.proposals.items():
        expert = chunks.scores[name][BESIDE]
        for who, area, scores in (("expert", "", expert), ("agent", f"{auroc(expert, proposals):.2f}", proposals)):
            shares = [(scores > chunks.threshold(name, alpha, BESIDE)).double().mean().item() for alpha in ALPHAS]
            found = [_number(value) for value in values_at(scores, QUANTILES)]
            lines.append(_line(name, who, area, *map(_percent, shares), *found))
    caption = (
        f"Proposals of {checked.agent} beside the expert's chunks of as many actions ({chunks.proposed}): area under "
        "the ROC curve, how many a gate of each alpha turns away, and below what scores 10, 50 and 90 % lie:"
    )
    header = ["score", "whose", "area", *(f"alpha {alpha:g}" for alpha in ALPHAS)]
    return Table(caption, [*header, *(f"{100 * one:g} %" for one in QUANTILES)], lines)


def values_at(scores: Tensor, shares: Sequence[float]) -> list[float]:
    """The scores (N,) below which these shares of them lie, each one that is there: infinite ones do no harm.

    NaN is left out; where there is nothing else, there are no such scores.
    """
    ordered = scores[~scores.isnan()].sort().values
    if not len(ordered):
        return []
    return [ordered[min(len(ordered) - 1, int(share * len(ordered)))].item() for share in shares]


def _line(*texts: str) -> list[Entry]:
    return [Entry(text) for text in texts]


def _area(area: float, low: float, high: float) -> str:
    return MISSING if math.isnan(area) else f"{area:.2f} [{low:.2f}, {high:.2f}]"


def _percent(share: float) -> str:
    return MISSING if math.isnan(share) else f"{100 * share:.0f} %"


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "none"
