"""What the wrapper's log, which `--policy.log` writes, says of an agent's own chunks: how unlike the expert's they are.

A log holds neither what was observed nor what was proposed, only what scores made of it: it tells what a gate would
have stopped, and nothing of what an edit would have done.
"""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.conformal import ConformalGate


@dataclass(frozen=True)
class LoggedChunk:
    """A line of a log.

    Attributes:
        length: How many actions the proposal had.
        perturbed: Whether something had been done to it.
        scores: What it scored, by name.
    """

    length: int
    perturbed: bool
    scores: dict[str, float]


@dataclass(frozen=True)
class Logged:
    """What a log says of proposals of one length.

    Attributes:
        length: How many actions they have.
        scores: Their scores by name, double, (M,) each.
        others: How many proposals of other lengths the log holds besides.
    """

    length: int
    scores: dict[str, Tensor]
    others: int


def read_log(file: Path) -> list[LoggedChunk]:
    """All chunks of a log.

    Args:
        file: JSON lines.

    Raises:
        ValueError: If a line is none of a log, or none has a score.
        OSError: If it cannot be read.
    """
    chunks = []
    for number, text in enumerate(file.read_text().splitlines(), start=1):
        try:
            line = json.loads(text)
            scores = {name: float(value) for name, value in line.get("scores", {}).items()}
            chunks.append(LoggedChunk(line["length"], line.get("perturbed", False), scores))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"line {number} of {file} is none that --policy.log writes: {error!r}") from error
    if not any(chunk.scores for chunk in chunks):
        raise ValueError(
            f"{file} holds no scores: --policy.score=reverse:steps=5 and --policy.method=none beside --policy.log let "
            "the wrapper log them without correcting anything"
        )
    return chunks


def of_one_length(chunks: Sequence[LoggedChunk], longest: int) -> Logged:
    """The scores of the proposals of the length that most have.

    Args:
        chunks: At least one.
        longest: Actions that the adapter's chunk has; more of a proposal are not judged.
    """
    lengths = [min(chunk.length, longest) for chunk in chunks]
    length, count = Counter(lengths).most_common(1)[0]
    alike = [chunk for chunk, own in zip(chunks, lengths, strict=True) if own == length]
    names = set.intersection(*(set(chunk.scores) for chunk in alike))
    scores = {
        name: torch.tensor([chunk.scores[name] for chunk in alike], dtype=torch.float64) for name in sorted(names)
    }
    return Logged(length, scores, len(chunks) - count)


def p_values(chunks: Sequence[LoggedChunk], names: Sequence[str], calibration: Calibration) -> dict[str, Tensor]:
    """Conformal p-values (m,) of the chunks that nothing perturbed, by score; those that no line has are left out.

    Args:
        chunks: A log's.
        names: Specifications of calibrated scores.
        calibration: What the adapter was calibrated on.
    """
    found = {}
    for name in names:
        values = [
            ConformalGate(calibration.of(name, calibration.judged(chunk.length))).p_value(torch.tensor([score]))
            for chunk in chunks
            if not chunk.perturbed and (score := chunk.scores.get(name)) is not None
        ]
        if values:
            found[name] = torch.cat(values)
    return found
