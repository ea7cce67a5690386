"""Which of an adapter's settings to take, without a simulator: the criterion of `gloves tune`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.corrupted import HEALTHY, Corrupted, Setting
from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.specification import NONE, parse, specification

STARTS, ALIGNS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), (0.0, 0.1, 0.3)
METHODS: Mapping[str, Sequence[str]] = {
    "feeg": [f"feeg:start={start},align={align}" for start, align in product(STARTS, ALIGNS)],
    "fpas": ["fpas:sigma=0.1", "fpas:sigma=0.3"],
    "copilot": [f"copilot:limit={limit}" for limit in (0.2, 0.4, 0.8, -1.0)],
}
"""What is tried of each editor; of another one its defaults."""
ALPHAS = (0.05, 0.1, 0.2, 0.3, 0.5)
ASKED = 0.05
"""Level of the test that an editor asks."""
MOST_CHANGE = 0.2
"""What moves an expert's own held-out chunks by more than so many standard deviations of the data, on average, would
soon spoil a healthy agent."""
EQUAL = 0.05
"""Shares that differ by less than this count as equal."""
WORST = 2.0
"""The most that a single chunk counts for, so that a few tiny faults made large do not decide."""
FAULTY = 1e-3
"""A chunk nearer than this to the expert's has no fault."""


@dataclass(frozen=True)
class Outcome:
    """What a setting makes of chunks, with a gate or without one.

    Attributes:
        method: Specification of the editor, `none` for the agent alone.
        gate: Whether what looks like the expert's passes.
        score: Specification of what gate or editor ask; None where neither does.
        alpha: The level of their test; None likewise.
        change: How far it moves the expert's own chunks, mean distance of an action in normalised units.
        edit: The same without the gate: how far its edit goes where there is nothing to be edited.
        remains: By fault, the share of a chunk's distance to the expert's that is left, on average; above 1 where it
            makes matters worse.
    """

    method: str
    gate: bool
    score: str | None
    alpha: float | None
    change: float
    edit: float
    remains: Mapping[str, float]

    @property
    def level(self) -> float:
        """The gate's, 1 where everything is edited."""
        return self.alpha if self.gate and self.alpha is not None else 1.0

    @property
    def mean(self) -> float:
        """What is left, on average over the faults."""
        return sum(self.remains.values()) / len(self.remains)


def settings_to_try(
    adapter: Any, methods: Sequence[str], gates: Mapping[tuple[str, float], ConformalGate]
) -> list[Setting]:
    """The editors that are tried of an adapter: those that `methods` names, by default `METHODS` of all that it has.

    Those that ask a score are given the first: a search by a dearer one takes minutes. Left out are editors that need
    the agent's flow, which a fault drawn at random has none of, and, where no score is calibrated, those that ask one.

    Args:
        adapter: The adapter.
        methods: Specifications.
        gates: See `gates_of`.

    Raises:
        ValueError: If a method is none of the adapter's, or nothing is left to be tried.
    """
    texts = methods or [text for name in adapter.editors for text in METHODS.get(name, [name])]
    found: list[Setting] = []
    for editor in (parse(text, adapter.editors, "method") for text in texts):
        if getattr(editor, "needs_agent", False):
            continue
        asks = getattr(editor, "needs_threshold", False)
        tests = [
            Setting(editor, score, ASKED, gate.threshold) for (score, alpha), gate in gates.items() if alpha == ASKED
        ]
        found += tests[:1] if asks else [Setting(editor)]
    if not found:
        raise ValueError(
            f"there is nothing to try: of {', '.join(texts)} each needs the agent's flow, or a calibration "
            "(gloves calibrate)"
        )
    return found


def outcomes(
    found: Corrupted,
    editors: Mapping[str, type],
    gates: Mapping[tuple[str, float], ConformalGate],
    logged: Mapping[str, Tensor],
) -> list[Outcome]:
    """What each setting makes of chunks, ungated and by every gate; the agent alone comes first.

    An editor that asks a test is gated by that one only: the wrapper has one score and one level.

    Args:
        found: What became of the chunks.
        editors: The adapter's editors by name.
        gates: By specification of the score and level.
        logged: P-values (m,) of an agent's own healthy chunks, by score. A gate that stops more of these than of the
            expert's is taken to change that many.

    Raises:
        ValueError: If no fault changes anything.
    """
    admits = {key: gate.admits(found.scores[key[0]]) for key, gate in gates.items()}
    faulty, own = found.proposed > FAULTY, found.kinds.index(HEALTHY)
    wrong = [index for index, kind in enumerate(found.kinds) if kind != HEALTHY and faulty[:, index].any()]
    if not wrong:
        raise ValueError(
            f"none of the faults {', '.join(found.kinds[1:])} changes any of {len(faulty)} chunks: take more"
        )

    def outcome(method: str, key: tuple[str, float] | None, gate: bool, edited: Tensor, moved: Tensor) -> Outcome:
        edit = change = moved[:, own].mean().item()
        if gate and key is not None:
            stopped = (logged[key[0]] <= key[1]).double().mean().item() if key[0] in logged else 0.0
            change = max(moved[:, own].masked_fill(admits[key][:, own], 0.0).mean().item(), stopped * edit)
            edited = torch.where(admits[key], found.proposed, edited)
        share = (edited / found.proposed).clamp(max=WORST)
        remains = {found.kinds[index]: share[:, index][faulty[:, index]].mean().item() for index in wrong}
        score, alpha = key or (None, None)
        return Outcome(method, gate, score, alpha, change, edit, remains)

    result = [outcome(NONE, None, False, found.proposed, torch.zeros_like(found.proposed))]
    for setting, edited, moved in zip(found.settings, found.edited, found.moved, strict=True):
        method = specification(setting.editor, editors)
        asked = None if setting.score is None or setting.alpha is None else (setting.score, setting.alpha)
        result.append(outcome(method, asked, False, edited, moved))
        result += [outcome(method, key, True, edited, moved) for key in gates if asked in (None, key)]
    return result


def best_first(found: Sequence[Outcome], most_change: float = MOST_CHANGE) -> list[Outcome]:
    """The outcomes in order: what `gloves tune` recommends, and behind it the others by what they leave.

    Of all settings that move the expert's own chunks by at most `most_change`, those whose mean share is within `EQUAL`
    of the smallest count as equal, and of these the one is taken whose edit is the gentlest to the expert's own chunks:
    a strong one loses what the agent is up to, which a chunk alone does not show. The agent left alone is among them.
    Of the levels of its gate the largest is taken that moves those chunks by no more than that: what a gate lets pass
    by mistake goes wrong at every step, and a chunk alone shows that neither.
    """
    ranked = sorted(found, key=lambda one: (one.change > most_change, one.mean))
    equal = [one for one in ranked if one.change <= most_change and one.mean <= ranked[0].mean + EQUAL]
    best = min(equal, key=lambda one: (one.edit, one.mean))
    levels = [one for one in ranked if one.method == best.method and one.score in (best.score, None)]
    best = max((one for one in levels if one.change <= most_change), key=lambda one: one.level)
    return [best, *(one for one in ranked if one is not best)]


def gates_of(
    calibration: Calibration | None, scores: Sequence[str], size: int
) -> dict[tuple[str, float], ConformalGate]:
    """The gates that are tried, by specification of the score and level: those that can turn something away."""
    if calibration is None:
        return {}
    return {
        (name, alpha): ConformalGate(calibration.of(name, size), alpha)
        for name in scores
        for alpha in ALPHAS
        if alpha >= calibration.smallest_alpha(name)
    }
