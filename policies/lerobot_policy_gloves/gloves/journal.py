"""What the wrapper did: one JSON line a chunk, and the totals."""

import json
import logging
from pathlib import Path
from typing import IO

import torch

from .correction import Correction

logger = logging.getLogger(__name__)


class Journal:
    """Keeps the totals of a run and, if given a file, writes a line for every chunk.

    Args:
        path: File of JSON lines; an existing one is appended to.
    """

    def __init__(self, path: Path | None):
        self.chunks = self.edited = 0
        self.distance = self.milliseconds = self.evaluations = 0.0
        self._file: IO[str] | None = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a", buffering=1)

    def note(
        self,
        correction: Correction,
        first_episode: int,
        step: int,
        running: torch.Tensor,
        perturbed: torch.Tensor | None = None,
    ) -> None:
        """Note a batch of chunks.

        Args:
            correction: What became of them, B rows.
            first_episode: Number of the episode of the first row.
            step: Step of the episode at which the chunks begin.
            running: Whether an environment's episode still runs, bool (B,). LeRobot goes on asking for actions until
                the last episode of a batch ends; what happens after an episode's end does not count.
            perturbed: Whether the proposals of the chunks were perturbed, bool (B,); None where nothing perturbs.
        """
        for row in running.nonzero().flatten().tolist():
            edited, distance = bool(correction.edited[row]), float(correction.distance[row])
            evaluations = float(correction.evaluations[row])
            self.chunks += 1
            self.edited += edited
            self.distance += distance
            self.milliseconds += correction.milliseconds
            self.evaluations += evaluations
            if self._file is None:
                continue
            line = {
                "episode": first_episode + row,
                "step": step,
                "length": correction.action.shape[1],
                "score": None if correction.score is None else float(correction.score[row]),
                "p_value": None if correction.p_value is None else float(correction.p_value[row]),
                "edited": edited,
                "distance": distance,
                "milliseconds": correction.milliseconds,
                "evaluations": evaluations,
            }
            if len(correction.each) > 1:
                line["scores"] = {name: float(score[row]) for name, score in correction.each.items()}
            if perturbed is not None:
                line["perturbed"] = bool(perturbed[row])
            # JSON has no infinity; a number beyond all that can be held is read as one.
            self._file.write(json.dumps(line).replace("Infinity", "1e999") + "\n")

    def summary(self) -> dict[str, float]:
        """Means over all chunks so far: intervention rate, distance, milliseconds and evaluations a chunk."""
        count = max(self.chunks, 1)
        return {
            "chunks": self.chunks,
            "intervention_rate": self.edited / count,
            "distance": self.distance / count,
            "milliseconds": self.milliseconds / count,
            "evaluations": self.evaluations / count,
        }

    def report(self) -> None:
        """Log the totals, if there are any."""
        if self.chunks:
            logger.info(
                "gloves: %(chunks)d chunks, intervention rate %(intervention_rate).3f, mean distance "
                "%(distance).3f (normalised), %(evaluations).1f evaluations and %(milliseconds).2f ms a chunk",
                self.summary(),
            )
