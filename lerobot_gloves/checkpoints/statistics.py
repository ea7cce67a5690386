"""What the data was like that a checkpoint was trained on, by the statistics that it normalises with."""

from collections.abc import Mapping
from typing import Any

import torch
from lerobot.configs import FeatureType, NormalizationMode
from lerobot.processor import NormalizerProcessorStep
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_gloves.checkpoints.processors import Pipeline
from lerobot_gloves.faults.fault import CONSTANT, Units

_SPREAD = {
    NormalizationMode.MEAN_STD: ("min", "max"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
}
"""Statistics that are equal where a normalisation divides by nothing."""


def action_range(preprocess: Pipeline) -> tuple[Tensor, Tensor] | None:
    """The least and the largest value of each entry of the data's actions, raw, (A,) each; None if nobody wrote it."""
    known = _statistics(preprocess).get(ACTION, {})
    return (known["min"], known["max"]) if {"min", "max"} <= known.keys() else None


class Constants:
    """Entries of observations and actions that never changed in the data.

    A normalisation divides them by a spread of nothing, and what is told from the data's value by its rounding alone
    becomes larger than all else. Held at that value they are what the checkpoint has seen, and say nothing.

    Args:
        preprocess: The checkpoint's preprocessor.
    """

    def __init__(self, preprocess: Pipeline):
        self._held: dict[str, tuple[Tensor, Tensor]] = {}
        steps = [step for step in preprocess.steps if isinstance(step, NormalizerProcessorStep)]
        modes: Mapping[Any, Any] = steps[0].norm_map if steps else {}
        for key, known in _statistics(preprocess).items():
            kind = FeatureType.ACTION if key == ACTION else steps[0].features[key].type
            names = _SPREAD.get(modes.get(kind, NormalizationMode.IDENTITY))
            if names is None or not set(names) <= known.keys():
                continue
            low, high = (known[name] for name in names)
            # Rounding is no spread, nor is what LeRobot adds to it so as not to divide by zero.
            constant = high - low <= (1e-6 * torch.maximum(low.abs(), high.abs())).clamp(min=steps[0].eps)
            if constant.any():
                self._held[key] = (constant, low)

    @property
    def action(self) -> Tensor | None:
        """Which entries of an action these are, bool (A,); None if there are none."""
        return self._held[ACTION][0] if ACTION in self._held else None

    def hold(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Raw features (B, ...) with these entries at the data's value."""
        held = dict(batch)
        for key, (constant, value) in self._held.items():
            if key in held:
                given = held[key]
                held[key] = torch.where(constant.to(given.device), value.to(given), given)
        return held


def action_units(preprocess: Pipeline, constants: Constants, held: Mapping[str, Tensor]) -> Units:
    """The robot's own units among a checkpoint's normalised actions; the spread of what never changes is `CONSTANT`.

    Args:
        preprocess: The checkpoint's preprocessor.
        constants: Its constants.
        held: Raw features (B, ...) of any frames, as `Constants.hold` gives them.
    """
    like = held[ACTION].flatten(1, -2)[:, :1]
    nothing, one = (
        preprocess(constants.hold({**held, ACTION: torch.full_like(like, value)}))[ACTION][0, 0] for value in (0.0, 1.0)
    )
    return Units(nothing, torch.where(one != nothing, 1 / (one - nothing), CONSTANT))


def _statistics(preprocess: Pipeline) -> dict[str, dict[str, Tensor]]:
    """Statistics by feature and name, of the features that a preprocessor normalises."""
    for step in preprocess.steps:
        if isinstance(step, NormalizerProcessorStep):
            known = {key: values for key, values in (step.stats or {}).items() if key in {*step.features, ACTION}}
            return {key: {name: torch.as_tensor(one) for name, one in values.items()} for key, values in known.items()}
    return {}
