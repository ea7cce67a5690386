"""What is kept of an episode: how it ended, and what the wrapper did in it."""

from dataclasses import dataclass, field

from lerobot_gloves.evaluation import histogram
from lerobot_gloves.evaluation.histogram import Histogram


@dataclass
class Episode:
    """One episode and what the wrapper did in it.

    Attributes:
        seed: Seed of its environment.
        success: Whether it succeeded.
        failure: Why it did not, in the environment's words; "" for a success.
        steps: Control steps that it took.
        chunks: Proposals that an adapter saw.
        edited: How many of them it edited.
        distance: Their mean distance between proposed and executed actions, 0 where nothing was edited, in the
            adapter's normalised units.
        milliseconds: Mean time of the adapter for one of them, the batch's time shared out.
        evaluations: Mean network evaluations of the adapter for one of them.
        scores_left: Histogram of the scores of those that were left as they are; empty if the method asks for none.
        scores_edited: The same of those that were edited.
    """

    seed: int
    success: bool = False
    failure: str = ""
    steps: int = 0
    chunks: int = 0
    edited: int = 0
    distance: float = 0.0
    milliseconds: float = 0.0
    evaluations: float = 0.0
    scores_left: Histogram = field(default_factory=dict)
    scores_edited: Histogram = field(default_factory=dict)

    def note(
        self, edited: bool, distance: float, milliseconds: float, evaluations: float, score: float | None = None
    ) -> None:
        """Count one more chunk."""
        self.chunks += 1
        self.edited += edited
        self.distance += (distance - self.distance) / self.chunks
        self.milliseconds += (milliseconds - self.milliseconds) / self.chunks
        self.evaluations += (evaluations - self.evaluations) / self.chunks
        if score is not None:
            histogram.add(self.scores_edited if edited else self.scores_left, score)
