"""Models from nothing, in stages that a killed run finds finished: record, train, export, calibrate, merge."""

import json
import re
import shutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from lerobot.utils.constants import CHECKPOINTS_DIR, LAST_CHECKPOINT_LINK, PRETRAINED_MODEL_DIR, TRAINING_STATE_DIR

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_gloves.checkpoints.card import CARD_NAME
from lerobot_gloves.checkpoints.publishing import renew_card
from lerobot_gloves.demo.export import export
from lerobot_gloves.recording.staging import staging_folder
from lerobot_gloves.system.processes import Command, console_script, run

PROGRESS = re.compile(r"(?:recording|Training|Scoring): .*?(?P<done>\d+)/(?P<total>\d+) ")
"""How far gloves record, lerobot-train and gloves calibrate say that they are."""


@dataclass(frozen=True)
class Dataset:
    """A LeRobotDataset on this disk.

    Attributes:
        repo_id: Its name, "user/name".
        root: Its folder.
    """

    repo_id: str
    root: Path

    @property
    def options(self) -> list[str]:
        """How a command is told of it."""
        return [f"--dataset.repo_id={self.repo_id}", f"--dataset.root={self.root}"]

    @property
    def is_whole(self) -> bool:
        """Whether it is there, and nothing is left to do for the command that makes it."""
        return (self.root / "meta" / "info.json").is_file() and not staging_folder(self.root).exists()


@dataclass(frozen=True)
class Stage(ABC):
    """A step on the way to a model: a command that makes something, and whether that is there.

    Attributes:
        label: What the user reads.
    """

    label: str

    @property
    @abstractmethod
    def done(self) -> bool:
        """Whether what it makes is there, whole."""

    @property
    @abstractmethod
    def words(self) -> list[str]:
        """The command, as one would type it where nothing is there yet."""

    def begin(self) -> list[str]:
        """Do what this process can do itself; returns the command that does the rest, if there is any."""
        return self.words


@dataclass(frozen=True)
class Record(Stage):
    """`gloves record`: demonstrations, or what an agent proposes.

    Attributes:
        env: Options that name the environment.
        dataset: What is recorded.
        options: Further options.
    """

    env: Sequence[str]
    dataset: Dataset
    options: Sequence[str]

    @property
    def done(self) -> bool:
        return self.dataset.is_whole

    @property
    def words(self) -> list[str]:
        return ["gloves", "record", *self.env, *self.dataset.options, *self.options]


@dataclass(frozen=True)
class Train(Stage):
    """`lerobot-train`, from the last checkpoint on if there is one.

    Attributes:
        configuration: File of the training configuration.
        data: Options that name the dataset, where the configuration does not.
        folder: The training run's.
        steps: Optimiser steps; None for what the configuration says.
        options: Further options over the configuration's.
    """

    configuration: Path
    data: Sequence[str]
    folder: Path
    steps: int | None = None
    options: Sequence[str] = ()

    @property
    def checkpoint(self) -> Path:
        """The last checkpoint's policy."""
        return self.folder / CHECKPOINTS_DIR / LAST_CHECKPOINT_LINK / PRETRAINED_MODEL_DIR

    @property
    def wanted(self) -> int:
        """Optimiser steps in the end."""
        return self.steps or yaml.safe_load(self.configuration.read_text())["steps"]

    @property
    def taken(self) -> int:
        """Optimiser steps of the last whole checkpoint; 0 if there is none."""
        state = self.checkpoint.with_name(TRAINING_STATE_DIR)
        if not state.is_dir():
            return 0
        from lerobot.common.train_utils import load_training_step  # takes seconds to import

        return load_training_step(state)

    @property
    def done(self) -> bool:
        return self.taken >= self.wanted

    @property
    def words(self) -> list[str]:
        steps = [] if self.steps is None else [f"--steps={self.steps}"]
        return [*self._train(self.configuration), *steps, *self.options]

    def begin(self) -> list[str]:
        if self.taken:
            # The checkpoint's own configuration has the other options; its steps may have been others.
            return [*self._train(self.checkpoint / "train_config.json"), f"--steps={self.wanted}", "--resume=true"]
        shutil.rmtree(self.folder, ignore_errors=True)  # which lerobot-train would refuse
        return self.words

    def _train(self, configuration: Path) -> list[str]:
        return ["lerobot-train", f"--config_path={configuration}", *self.data, f"--output_dir={self.folder}"]


@dataclass(frozen=True)
class Export(Stage):
    """`python -m lerobot_gloves.demo.export`: averaged weights in half precision.

    Attributes:
        checkpoint: A training run's.
        folder: The new folder.
    """

    checkpoint: Path
    folder: Path

    @property
    def done(self) -> bool:
        return self.folder.is_dir()

    @property
    def words(self) -> list[str]:
        return ["python", "-m", "lerobot_gloves.demo.export", str(self.checkpoint), str(self.folder)]

    def begin(self) -> list[str]:
        export(self.checkpoint, self.folder)  # sooner done than a process is started
        return []


@dataclass(frozen=True)
class Calibrate(Stage):
    """`gloves calibrate`.

    Attributes:
        policy: Folder of the adapter.
        dataset: What it was trained on.
        scores: The nonconformity scores.
    """

    policy: Path
    dataset: Dataset
    scores: Sequence[str]

    @property
    def done(self) -> bool:
        return (self.policy / CALIBRATION_NAME).is_file()

    @property
    def words(self) -> list[str]:
        scores = f"--scores={json.dumps(self.scores)}"
        return ["gloves", "calibrate", f"--policy.path={self.policy}", *self.dataset.options, scores]


@dataclass(frozen=True)
class Card(Stage):
    """The model card in a checkpoint's folder, which a calibration writes as well.

    Attributes:
        policy: The folder.
    """

    policy: Path

    @property
    def done(self) -> bool:
        return (self.policy / CARD_NAME).is_file()

    @property
    def words(self) -> list[str]:
        return []  # nothing to type: `gloves push` writes it anew

    def begin(self) -> list[str]:
        renew_card(self.policy, None)
        return []


@dataclass(frozen=True)
class Merge(Stage):
    """`lerobot-edit-dataset`: several datasets in one.

    Attributes:
        parts: Them.
        target: The new one.
    """

    parts: Sequence[Dataset]
    target: Dataset

    @property
    def done(self) -> bool:
        return self.target.is_whole

    @property
    def words(self) -> list[str]:
        return [
            "lerobot-edit-dataset",
            "--operation.type=merge",
            f"--operation.repo_ids={json.dumps([part.repo_id for part in self.parts])}",
            f"--operation.roots={json.dumps([str(part.root) for part in self.parts])}",
            f"--new_repo_id={self.target.repo_id}",
            f"--new_root={self.target.root}",
        ]


def make(stages: Sequence[Stage], logs: Path, *, began: float) -> None:
    """Make what is missing of stages that do not wait for one another, two side by side.

    Args:
        stages: In the order in which they are begun.
        logs: Folder of a log for each, named by its label.
        began: When all of it began (`time.monotonic`), for the elapsed time.

    Raises:
        ChildProcessError: If a command fails.
    """
    commands = []
    for stage in stages:
        if not stage.done and (words := stage.begin()):
            log = logs / f"{stage.label.replace(' ', '_')}.log"
            commands.append(Command(stage.label, [console_script(words[0]), *words[1:]], log, PROGRESS))
    run(commands, began=began)
