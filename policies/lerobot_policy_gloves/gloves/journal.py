"""What the wrapper did: one JSON line a chunk, and the totals."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from torch import Tensor

from .correction import Correction
from .latency import Latencies
from .motion import Motion

logger = logging.getLogger(__name__)


class Journal:
    """Keeps the totals of a run and, if given a file, writes a line for every chunk.

    LeRobot goes on asking for actions until the last episode of a batch ends; what happens after an episode's end does
    not count. Where nobody says which episodes run, what they show does (`Motion`): the chunks of one that stands still
    count as soon as it moves again.

    Args:
        path: File of JSON lines; an existing one is appended to.
        control_period: Milliseconds between two actions; None if nobody knows.
        actions: Whether the lines hold the proposed and the executed actions.
    """

    def __init__(self, path: Path | None, control_period: float | None = None, actions: bool = False):
        self.chunks = self.edited = 0
        self.distance = self.milliseconds = self.evaluations = 0.0
        self.latencies = Latencies()
        self.control_period = control_period
        self._motion = Motion()
        self._waiting: list[tuple[int, dict[str, Any]]] = []
        self._file: IO[str] | None = None
        self._actions = actions
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a", buffering=1)

    def reset(self) -> None:
        """The episodes that ran are over."""
        self._motion.reset()
        self._waiting.clear()

    def see(self, observation: Mapping[str, Any], batch_size: int) -> None:
        """What B environments show, at every step of episodes of which nobody says whether they run."""
        self._motion.see(observation, batch_size)
        waiting, self._waiting = self._waiting, []
        for row, line in waiting:
            if self._motion.moves(row):
                self._count(line)
            else:
                self._waiting.append((row, line))

    def note(
        self,
        correction: Correction,
        first_episode: int,
        step: int,
        running: Tensor | None = None,
        perturbed: Tensor | None = None,
    ) -> None:
        """Note a batch of chunks.

        Args:
            correction: What became of them, B rows.
            first_episode: Number of the episode of the first row.
            step: Step of the episode at which the chunks begin.
            running: Whether an environment's episode still runs, bool (B,), by a caller who knows; only their chunks
                were corrected. None: all were, and `see` has been told what the environments show.
            perturbed: Whether the proposals of the chunks were perturbed, bool (B,); None where nothing perturbs.
        """
        count = len(correction.edited)
        rows = range(count) if running is None else running.nonzero().flatten().tolist()
        # The robot waits for a batch as a whole.
        self.latencies.note(correction.milliseconds * len(rows))
        for row in rows:
            line: dict[str, Any] = {
                "episode": first_episode + row,
                "step": step,
                "length": correction.action.shape[1],
                "score": None if correction.score is None else float(correction.score[row]),
                "p_value": None if correction.p_value is None else float(correction.p_value[row]),
                "edited": bool(correction.edited[row]),
                "distance": float(correction.distance[row]),
                "milliseconds": correction.milliseconds,
                "evaluations": float(correction.evaluations[row]),
            }
            if correction.each:
                line["scores"] = {name: float(score[row]) for name, score in correction.each.items()}
            if self._actions:
                line["proposed"] = correction.proposal[row].tolist()
                line["executed"] = correction.action[row].tolist()
            if perturbed is not None:
                line["perturbed"] = bool(perturbed[row])
            if running is None and self._motion.over(row):
                self._waiting.append((row, line))
            else:
                self._count(line)

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
        if not self.chunks:
            return
        known = self.control_period is not None
        logger.info(
            "gloves: %(chunks)d chunks, %(edited).1f %% edited, mean distance %(distance).3f (normalised), "
            "%(evaluations).1f evaluations a chunk, latency p50 %(p50).1f ms, p99 %(p99).1f ms%(period)s",
            {
                **self.summary(),
                "edited": 100 * self.edited / self.chunks,
                "p50": self.latencies.quantile(0.5),
                "p99": self.latencies.quantile(0.99),
                "period": f" of a control period of {self.control_period:.1f} ms" if known else "",
            },
        )

    def _count(self, line: Mapping[str, Any]) -> None:
        self.chunks += 1
        self.edited += line["edited"]
        self.distance += line["distance"]
        self.milliseconds += line["milliseconds"]
        self.evaluations += line["evaluations"]
        if self._file is not None:
            # JSON has no infinity; a number beyond all that can be held is read as one.
            self._file.write(json.dumps(line).replace("Infinity", "1e999") + "\n")
