"""A calibration: the scores of held-out expert chunks that a gate compares proposals with."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from lerobot_gloves.checkpoints.beside import beside
from lerobot_gloves.system.files import whole

CALIBRATION_NAME = "calibration.safetensors"


@dataclass(frozen=True)
class Calibration:
    """Scores of held-out expert chunks, and what they were made from.

    Attributes:
        scores: Per score specification, as `reverse:steps=1`, a tensor (L, n): a row holds the scores of the n chunks
            of which so many actions count as `lengths` says.
        repo_id: The dataset.
        revision: Its revision.
        episodes: Its episodes that were scored.
        episode_of: Which of them each of the n chunks is of; none where a calibration is from before this was noted.
        weights: Hash of the adapter's weights, see `weights_hash`.
        guidance: The adapter's option of that name, if it has one: it scores by the guided flow.
        lengths: How many actions count in each row, ascending; none where every length from 1 to L has its row.
    """

    scores: Mapping[str, Tensor]
    repo_id: str
    revision: str
    episodes: tuple[int, ...]
    weights: str
    guidance: float = 1.0
    episode_of: tuple[int, ...] = ()
    lengths: tuple[int, ...] = ()

    def judged(self, length: int) -> int:
        """How many actions of a proposal of `length` are judged: the longest calibrated length that is not longer.

        The leading actions of the expert's chunks were scored alike, so the test is exact for them.

        Raises:
            ValueError: If only longer ones were calibrated.
        """
        if fitting := [known for known in self.calibrated if known <= length]:
            return max(fitting)
        raise ValueError(
            f"the calibration holds lengths {_listed(self.calibrated)}, but a proposal has {length} actions: "
            f"run gloves calibrate --lengths='[{length}]'"
        )

    @property
    def calibrated(self) -> tuple[int, ...]:
        """The lengths that have a row of their own."""
        return self.lengths or tuple(range(1, 1 + max(len(table) for table in self.scores.values())))

    def of(self, specification: str, length: int, *, by_episode: bool = False) -> Tensor:
        """Scores (n,) of chunks of `length` actions, or the largest of each episode that has any, (e,).

        Raises:
            ValueError: If this specification or length was not calibrated, or it is not known what is of which episode.
        """
        if specification not in self.scores:
            raise ValueError(
                f"the adapter is not calibrated for score {specification!r}, only for {', '.join(self.scores)}: "
                f"run gloves calibrate --scores='[{specification}]'"
            )
        if length not in self.calibrated:
            raise ValueError(f"the calibration holds lengths {_listed(self.calibrated)}, not {length}")
        scores = self.scores[specification][self.calibrated.index(length)]
        if not by_episode:
            return scores
        if not self.episode_of:
            raise ValueError("the calibration does not say which chunks are of one episode: run gloves calibrate again")
        of = torch.tensor(self.episode_of)
        return torch.stack([scores[of == episode].max() for episode in of.unique()])

    def smallest_alpha(self, specification: str, *, by_episode: bool = False) -> float:
        """The smallest alpha at which a gate by this score alone turns something away, whatever the length.

        A p-value is at least 1 / (n + 1) for n scores, and as no score lies above an infinite one, each of these that
        there are makes it larger by as much.
        """
        rows = [self.of(specification, length, by_episode=by_episode) for length in self.calibrated]
        return max((1 + int(row.isposinf().sum())) / (1 + len(row)) for row in rows)

    def check(self, weights: str) -> None:
        """Refuse a calibration of other weights.

        Raises:
            ValueError: If the hashes differ.
        """
        if weights != self.weights:
            raise ValueError(
                f"the calibration belongs to other weights ({self.weights[:12]}) than the adapter's "
                f"({weights[:12]}): run gloves calibrate again"
            )

    def save(self, folder: Path) -> None:
        """Write `calibration.safetensors` into a checkpoint's folder.

        Raises:
            OSError: If it cannot be written.
        """
        about = {
            "repo_id": self.repo_id,
            "revision": self.revision,
            "episodes": list(self.episodes),
            "weights": self.weights,
            "guidance": self.guidance,
            "episode_of": list(self.episode_of),
            "lengths": list(self.lengths),
        }
        scores = {key: value.contiguous() for key, value in self.scores.items()}
        path = folder / CALIBRATION_NAME
        try:
            with whole(path) as part:
                save_file(scores, part, metadata={"gloves": json.dumps(about)})
        except SafetensorError as error:  # also for a full disk
            raise OSError(f"cannot write {path}: {error}") from error

    @classmethod
    def load(cls, checkpoint: str | Path, revision: str | None = None) -> "Calibration | None":
        """Read the calibration of a checkpoint, a folder or a Hub id; None if it has none.

        Raises:
            ValueError: If the file is not a calibration.
        """
        path = beside(checkpoint, CALIBRATION_NAME, revision, "calibration")
        if path is None:
            return None
        try:
            with safe_open(path, framework="pt") as file:
                about = json.loads((file.metadata() or {})["gloves"])
                scores = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118, not a dict
            lists = {key: tuple(value) for key, value in about.items() if isinstance(value, list)}
            return cls(scores=scores, **{**about, **lists})
        except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path.name} of {checkpoint} is not a readable calibration: {error}") from error


def _listed(lengths: Sequence[int]) -> str:
    every = list(lengths) == list(range(lengths[0], lengths[-1] + 1)) and len(lengths) > 1
    return f"{lengths[0]} to {lengths[-1]}" if every else ", ".join(map(str, lengths))


def weights_hash(weights: Mapping[str, Tensor]) -> str:
    """SHA-256 of a state dict's names, types, shapes and values, independent of the file that holds it."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        tensor = weights[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)} ".encode())
        digest.update(tensor.flatten().view(torch.uint8).numpy().tobytes() if tensor.numel() else b"")
    return digest.hexdigest()
