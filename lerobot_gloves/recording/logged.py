"""Scores of an agent's proposals from the wrapper's log, which `--policy.log` writes."""

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor


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


def read_log(file: Path, names: list[str], longest: int) -> Logged:
    """Read a log: of the proposals of the length that most have.

    Args:
        file: The log.
        names: Scores to read. A log of a single score does not name it, so that there must be one.
        longest: Actions that the adapter's chunk has; more of a proposal are not judged.

    Raises:
        ValueError: If it is no log, or has not these scores.
        OSError: If it cannot be read.
    """
    try:
        lines = [json.loads(line) for line in file.read_text().splitlines() if line.strip()]
        lengths = Counter(min(line["length"], longest) for line in lines)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file} is not a log of the wrapper's, as --policy.log writes it: {error!r}") from error
    if not lines:
        raise ValueError(f"{file} is empty")
    length, count = lengths.most_common(1)[0]
    alike = [line for line in lines if min(line["length"], longest) == length]
    several = all("scores" in line for line in alike)
    if not several and (len(names) != 1 or any(line.get("score") is None for line in alike)):
        raise ValueError(
            f"{file} does not name its score: say which it was, as in --scores='[reverse:steps=1]'"
            if all(line.get("score") is not None for line in alike)
            else f"{file} holds no scores: it is of an adapter that has none, or of none"
        )
    there = list(alike[0]["scores"]) if several else names
    if lacking := [name for name in names if name not in there]:
        raise ValueError(f"{file} has no {', '.join(lacking)}, but {', '.join(there)}: name these by --scores")
    found = {name: [line["scores"][name] if several else line["score"] for line in alike] for name in names}
    scores = {name: torch.tensor(values, dtype=torch.float64) for name, values in found.items()}
    return Logged(length, scores, len(lines) - count)
