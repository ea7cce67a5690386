"""The demo's pair from nothing, in stages that a killed run finds finished: record, train, export, calibrate."""

import json
import re
import shlex
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot.utils.constants import TRAINING_STATE_DIR

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_gloves.demo import AGENT, EXPERT_FLOW, PACKAGED, PAIR
from lerobot_gloves.demo.export import describe, export
from lerobot_gloves.recording.staging import staging_folder
from lerobot_gloves.system.processes import Job, clock, console_script, run

DATASET_ID = "gloves/slalom_state"
PROGRESS = re.compile(r"(?:recording|Training|Scoring): .*?(?P<done>\d+)/(?P<total>\d+) ")
"""How far gloves record, lerobot-train and gloves calibrate say that they are."""


@dataclass(frozen=True)
class Training:
    """What to train, and where.

    Attributes:
        root: Folder of all that is made; the pair ends up in its subfolders `agent` and `expert_flow`.
        demonstrations: How many episodes of the scripted expert to train on.
        steps: Optimiser steps; None for what the configurations say.
        scores: The nonconformity scores to calibrate.
    """

    root: Path
    demonstrations: int = 400
    steps: int | None = None
    scores: tuple[str, ...] = ("reverse:steps=1", "reverse:steps=5")

    @property
    def dataset(self) -> Path:
        """Folder of the demonstrations."""
        return self.root / "dataset"

    def run_folder(self, name: str) -> Path:
        """Folder of the training run of the agent or the expert flow."""
        return self.root / "training" / name

    def checkpoint(self, name: str) -> Path:
        """Its last checkpoint."""
        return self.run_folder(name) / "checkpoints" / "last" / "pretrained_model"

    def record_command(self) -> list[str]:
        return [
            "gloves",
            "record",
            "--env.type=gloves_slalom",
            "--env.obs_type=state",
            f"--dataset.repo_id={DATASET_ID}",
            f"--dataset.root={self.dataset}",
            f"--dataset.num_episodes={self.demonstrations}",
            "--num_workers=2",
        ]

    def train_command(self, name: str, configurations: Path, *, resume: bool = False) -> list[str]:
        folder = self.run_folder(name)
        source = self.checkpoint(name) / "train_config.json" if resume else configurations / f"{name}.yaml"
        options = ["--resume=true"] if resume else []
        options += [f"--dataset.root={self.dataset}", f"--output_dir={folder}"]
        options += [] if self.steps is None else [f"--steps={self.steps}"]
        return ["lerobot-train", f"--config_path={source}", *options]

    def calibrate_command(self) -> list[str]:
        return [
            "gloves",
            "calibrate",
            f"--policy.path={self.root / EXPERT_FLOW}",
            f"--dataset.repo_id={DATASET_ID}",
            f"--dataset.root={self.dataset}",
            f"--scores={json.dumps(self.scores)}",
        ]

    def job(self, label: str, command: Sequence[str]) -> Job:
        """A command of this environment with its log beside what it makes."""
        program, *options = command
        log = self.root / "logs" / f"{label.replace(' ', '_')}.log"
        return Job(label, [console_script(program), *options], log, PROGRESS)

    def recipe(self) -> list[str]:
        """The commands in order, as one would type them in a checkout's root."""
        here = Training(Path("outputs/demo"), self.demonstrations, self.steps, self.scores)
        configurations = Path("lerobot_gloves/demo")
        exports = [
            ["python", "-m", "lerobot_gloves.demo.export", str(here.checkpoint(name)), str(here.root / name)]
            for name in PAIR
        ]
        commands = [
            here.record_command(),
            *(here.train_command(name, configurations) for name in PAIR),
            *exports,
            here.calibrate_command(),
        ]
        return [shlex.join(command) for command in commands]


def train_pair(training: Training, *, began: float) -> tuple[Path, Path]:
    """Make the pair, or what is left to do of it.

    Args:
        training: What to make.
        began: When the demo began (`time.monotonic`), for the elapsed time.

    Returns:
        Folders of the agent and of the expert flow.

    Raises:
        ChildProcessError: If a command fails.
        ValueError: If the folder holds a pair, or part of one, that was made with other settings.
    """
    root = training.root
    claim(training)

    def stage(number: int, title: str, jobs: Sequence[Job], done: bool) -> None:
        now = clock(time.monotonic() - began)
        print(f"[{now}] training {number} of 4, {title}{': already done' if done else ''}", flush=True)
        if not done:
            run(jobs, began=began)

    recording = training.job("recording", training.record_command())
    stage(1, f"{training.demonstrations} demonstrations", [recording], is_recorded(training.dataset))
    untrained = [name for name in PAIR if not (root / name).is_dir() and not is_trained(training, name)]
    stage(2, "agent and expert flow", [train_job(training, name) for name in untrained], not untrained)
    unexported = [name for name in PAIR if not (root / name).is_dir()]
    stage(3, "averaged weights in half precision", [], not unexported)
    for name in unexported:
        export(training.checkpoint(name), root / name)
    calibration = training.job("calibration", training.calibrate_command())
    stage(4, "calibration", [calibration], (root / EXPERT_FLOW / CALIBRATION_NAME).is_file())
    (root / "README.md").write_text(describe(root, PAIR, training.recipe()))
    return root / AGENT, root / EXPERT_FLOW


def claim(training: Training) -> None:
    """Note in the folder what is made there.

    Raises:
        ValueError: If it is another pair's.
    """
    settings = {
        "demonstrations": training.demonstrations,
        "steps": training.steps,
        "scores": list(training.scores),
        **{name: (PACKAGED / f"{name}.yaml").read_text() for name in PAIR},
    }
    file = training.root / "training.json"
    if file.exists():
        found = json.loads(file.read_text())
        different = ", ".join(key for key in settings if found.get(key) != settings[key])
        if different:
            raise ValueError(
                f"{training.root} holds a pair that was made with another setting of {different}: "
                "choose another --output_dir or delete that folder"
            )
    training.root.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(settings, indent=2))


def is_recorded(dataset: Path) -> bool:
    """Whether `gloves record` has finished the dataset of that folder."""
    return (dataset / "meta" / "info.json").is_file() and not staging_folder(dataset).exists()


def steps_done(run: Path) -> int:
    """Optimiser steps of the last whole checkpoint of a training run's folder; 0 if it has none."""
    from lerobot.common.train_utils import load_training_step  # takes seconds to import

    last = run / "checkpoints" / "last"
    return load_training_step(last / TRAINING_STATE_DIR) if last.is_dir() else 0


def is_trained(training: Training, name: str) -> bool:
    """Whether the last checkpoint is the last of all."""
    done = steps_done(training.run_folder(name))
    return bool(done) and done >= json.loads((training.checkpoint(name) / "train_config.json").read_text())["steps"]


def train_job(training: Training, name: str) -> Job:
    """A training run from its last checkpoint on, from the start if it has none."""
    resume = training.checkpoint(name).is_dir()
    if not resume:
        shutil.rmtree(training.run_folder(name), ignore_errors=True)
    return training.job(name.replace("_", " "), training.train_command(name, PACKAGED, resume=resume))
