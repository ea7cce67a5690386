"""The gate of a wrapper: the scores that it names, and what the adapter's calibration says of them."""

import logging
import math
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.adapter import Adapter, BoundAdapter, pad
from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.conformal import JointGate
from lerobot_gloves.scores import Joint, Leading
from lerobot_gloves.scores.joint import excess
from lerobot_gloves.specification import specification

from .settings import Settings

logger = logging.getLogger(__name__)


class Gate:
    """Scores proposals and tells which of them pass.

    Attributes:
        names: The specification of each score.

    Args:
        settings: Method and gate.
        adapter: What scores.
        scores: The scores that the wrapper names; none for an adapter without any.
        calibration: The adapter's; None if it has none.
        needed: Whether somebody needs thresholds, be it the gate itself or the editor.

    Raises:
        ValueError: If they are needed, and a score is not calibrated or nothing could ever be turned away by it.
    """

    def __init__(
        self,
        settings: Settings,
        adapter: Adapter,
        scores: tuple[Any, ...],
        calibration: Calibration | None,
        needed: bool,
    ):
        self.scores = scores
        self.names = [specification(score, adapter.scores) for score in scores]
        self._alpha, self._by_episode = settings.alpha, settings.alpha_of == "episodes"
        known = calibration is not None and all(name in calibration.scores for name in self.names)
        self._calibration = calibration if needed or known else None
        self._needed = needed
        self._tests: dict[int, JointGate] = {}
        self._judged: dict[int, int] = {}
        # What is wrong shall not wait for the first chunk that has such a length.
        for length in calibration.calibrated if needed and calibration is not None else ():
            if (test := self.test(length)) is not None and settings.alpha > 0:
                self._check(test)

    def judged(self, length: int) -> int:
        """How many of a proposal's actions are scored, the first ones; all where nothing is compared.

        A test is of chunks as long as those that it was calibrated on. Of a proposal that is between two calibrated
        lengths as many count as the shorter one has.

        Raises:
            ValueError: If all calibrated lengths are longer.
        """
        if self._calibration is None or not self.names or not self._needed:
            return length
        if length not in self._judged:
            self._judged[length] = judged = self._calibration.judged(length)
            if judged < length:
                told = (
                    "gloves: proposals of %d actions are judged by their first %d: calibrate that length by --lengths"
                )
                logger.warning(told, length, judged)
        return self._judged[length]

    def test(self, length: int) -> JointGate | None:
        """The test of proposals of that many actions; None if nobody needs one and a score is uncalibrated."""
        judged = self.judged(length)
        if self._calibration is None or not self.names or judged not in self._calibration.calibrated:
            return None
        if judged not in self._tests:
            tables = [self._calibration.of(name, judged, by_episode=self._by_episode) for name in self.names]
            self._tests[judged] = JointGate(tables, self._alpha)
        return self._tests[judged]

    def score(self, bound: BoundAdapter, chunk: Tensor, length: int) -> Tensor:
        """Scores (m, B) of proposals (B, T, A) of `length` actions, of which as many count as are judged."""
        judged = self.judged(length)
        leading = pad(chunk[:, :judged], chunk.shape[1])
        return torch.stack([bound.score(leading, score, length=judged) for score in self.scores])

    def summary(self, scores: Tensor, length: int) -> Tensor:
        """One number (B,) for each proposal of scores (m, B): the score, or of several the worst one's excess."""
        if len(scores) == 1:
            return scores[0]
        test = self.test(length)
        assert test is not None  # several scores are compared by their calibration alone
        return excess(scores, test.thresholds)

    def aim(self, length: int) -> tuple[Any, float | None]:
        """The score that an editor may ask, and the largest value that passes; None without one, or a calibration."""
        test, judged = self.test(length), self.judged(length)
        scores = self.scores if judged == length else tuple(Leading(score, judged) for score in self.scores)
        if test is None or len(scores) == 1:
            return next(iter(scores), None), None if test is None else test.thresholds[0]
        return Joint(scores, test.thresholds), 0.0

    def _check(self, test: JointGate) -> None:
        unit, shares = "episodes" if self._by_episode else "chunks", len(test.gates)
        for name, gate in zip(self.names, test.gates, strict=True):
            if gate.threshold < math.inf:
                continue
            told = f"alpha is {self._alpha}" + (f", shared by {shares} scores" if shares > 1 else "")
            count, enough = len(gate.scores), math.ceil(shares / self._alpha) - 1
            if count < enough:
                raise ValueError(
                    f"{told}, but with {count} calibration {unit} nothing can be that unlikely: the gate would let all "
                    f"pass; calibrate on at least {enough} {unit}"
                )
            raise ValueError(
                f"{told}, but of {int(gate.scores.isinf().sum())} in {count} calibration {unit} {name} is infinite: "
                "the gate would let all pass; take another score"
            )
