"""A study on the disk: its plan, and every episode as soon as it is over."""

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_gloves.recording import staging
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.system.files import write_text

ASSISTED, COMMANDED, EDITED = "assisted", "commanded", "edited"
"""Keys of a frame beside the observation and the action that was executed. LeRobot hands no policy these."""


@dataclass(frozen=True)
class Trial:
    """An episode that is to be driven.

    Attributes:
        seed: Of its environment.
        assisted: Whether the person is helped.
    """

    seed: int
    assisted: bool


def draw_trials(episodes: int, first: int, rng: np.random.Generator) -> list[Trial]:
    """The seeds from `first` on, each with and without assistance, in random order.

    Args:
        episodes: How many there are in all; even.
        first: The first seed.
        rng: What the order is drawn from.
    """
    trials = [Trial(first + i, assisted) for i in range(episodes // 2) for assisted in (False, True)]
    return [trials[i] for i in rng.permutation(len(trials))]


class StudyFolder:
    """Takes up a study that was stopped, or begins one.

    Attributes:
        root: The folder, which also holds what comes of the study.
        trials: What is driven, in this order. It is drawn anew for every study, so that nobody can know it, and kept.

    Args:
        root: The folder.
        settings: What the episodes depend on, but for the order.
        episodes: How many episodes; even.
        seed: Of the first corridor.

    Raises:
        ValueError: If the folder holds episodes that were driven with other settings, or something else.
    """

    def __init__(self, root: Path, settings: Mapping[str, Any], episodes: int, seed: int) -> None:
        self.root, self.staged = root, root / "episodes"
        if root.is_dir() and any(root.iterdir()) and not self.staged.is_dir():
            raise ValueError(f"{root} holds other files: choose another --output_dir")
        staging.open_staging(self.staged, {**settings, "episodes": episodes, "seed": seed})
        plan = root / "plan.json"
        if not staging.staged(self.staged) or not plan.is_file():
            drawn = draw_trials(episodes, seed, np.random.default_rng(secrets.randbits(64)))
            write_text(plan, json.dumps([asdict(trial) for trial in drawn], indent=1) + "\n")
        self.trials: Sequence[Trial] = [Trial(**trial) for trial in json.loads(plan.read_text())]

    @property
    def done(self) -> int:
        """How many episodes are over, the first ones."""
        present = staging.staged(self.staged)
        return next((index for index in range(len(self.trials)) if index not in present), len(self.trials))

    def save(self, index: int, episode: StagedEpisode) -> None:
        """Keep an episode; after a crash it is there whole or not at all."""
        staging.save(self.staged, index, episode)

    def load(self) -> list[StagedEpisode]:
        """All episodes that are over, in the order of the trials."""
        return [staging.load(self.staged, index) for index in range(self.done)]
