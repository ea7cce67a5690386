"""A recommendation: what `gloves tune` chose for an adapter, used by whoever names no method."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lerobot_gloves.checkpoints.beside import beside
from lerobot_gloves.system.files import whole

RECOMMENDATION_NAME = "gloves_recommendation.json"


@dataclass(frozen=True)
class Recommendation:
    """An adapter's method and gate, and what they were chosen on.

    Attributes:
        method: The editor with every option written out, as `--policy.method` takes it.
        gate: Whether chunks that look like the expert's pass.
        score: What the gate, or the editor, measures; None where neither asks.
        alpha: The gate's level, in [0, 1].
        repo_id: The dataset whose held-out chunks chose.
        chunks: How many of them did.
        weights: Hash of the adapter's weights, see `weights_hash`.
    """

    method: str
    gate: bool
    score: str | None
    alpha: float
    repo_id: str
    chunks: int
    weights: str

    @property
    def flags(self) -> list[str]:
        """The wrapper's options that say the same."""
        found = [f"--policy.method={self.method}"]
        if self.gate:
            found.append("--policy.gate=true")
        if self.score is not None:
            found += [f"--policy.score={self.score}", f"--policy.alpha={self.alpha:g}"]
        return found

    def check(self, weights: str) -> None:
        """Refuse a recommendation for other weights.

        Raises:
            ValueError: If the hashes differ.
        """
        if weights != self.weights:
            raise ValueError(
                f"{RECOMMENDATION_NAME} belongs to other weights ({self.weights[:12]}) than the adapter's "
                f"({weights[:12]}): run gloves tune again, or name --policy.method"
            )

    def save(self, folder: Path) -> None:
        """Write `gloves_recommendation.json` into a checkpoint's folder.

        Raises:
            OSError: If it cannot be written.
        """
        with whole(folder / RECOMMENDATION_NAME) as part:
            part.write_text(json.dumps(asdict(self), indent=2) + "\n")

    @classmethod
    def load(cls, checkpoint: str | Path, revision: str | None = None) -> "Recommendation | None":
        """Read the recommendation of a checkpoint, a folder or a Hub id; None if it has none.

        Raises:
            ValueError: If the file is not a recommendation.
        """
        path = beside(checkpoint, RECOMMENDATION_NAME, revision, "recommendation")
        if path is None:
            return None
        try:
            about: Any = json.loads(path.read_text())
            return cls(**about)
        except (OSError, TypeError, ValueError) as error:
            raise ValueError(f"{path.name} of {checkpoint} is not a readable recommendation: {error}") from error
