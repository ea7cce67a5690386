"""The demo's trio from nothing: what it is made by, and that one folder holds one trio."""

import json
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_gloves.demo import COPILOT, EXPERT_FLOW, PACKAGED, TRIO
from lerobot_gloves.demo.export import describe
from lerobot_gloves.demo.pipeline import Calibrate, Dataset, Export, Record, Stage, Train, make
from lerobot_gloves.system.files import whole
from lerobot_gloves.system.processes import clock

ADAPTERS = (EXPERT_FLOW, COPILOT)


@dataclass(frozen=True)
class Training:
    """What to train, and where.

    Attributes:
        root: Folder of all that is made; the trio ends up in its subfolders `agent`, `expert_flow` and `copilot`.
        demonstrations: How many episodes of the scripted expert to train on.
        steps: Optimiser steps; None for what the configurations say.
        scores: The nonconformity scores to calibrate, besides the copilot's own.
        configurations: Folder of the training configurations.
    """

    root: Path
    demonstrations: int = 400
    steps: int | None = None
    scores: tuple[str, ...] = ("reverse:steps=1", "reverse:steps=5")
    configurations: Path = PACKAGED

    @property
    def dataset(self) -> Dataset:
        """The demonstrations."""
        return Dataset("gloves/slalom_state", self.root / "dataset")

    @property
    def record(self) -> Record:
        """The recording of them."""
        env = ["--env.type=gloves_slalom", "--env.obs_type=state"]
        options = [f"--dataset.num_episodes={self.demonstrations}", "--num_workers=2"]
        return Record("recording", env, self.dataset, options)

    def train(self, name: str) -> Train:
        """The training run of one of the three."""
        file, folder = self.configurations / f"{name}.yaml", self.root / "training" / name
        data = [f"--dataset.root={self.dataset.root}"]  # its name stands in the configuration
        return Train(name.replace("_", " "), file, data, folder, self.steps)

    def export(self, name: str) -> Export:
        """The averaged weights of one of them, where the trio ends up."""
        return Export(f"export of {name.replace('_', ' ')}", self.train(name).checkpoint, self.root / name)

    def calibrate(self, name: str) -> Calibrate:
        """The calibration of one of the adapters that were exported."""
        scores = (*self.scores, "correction") if name == COPILOT else self.scores
        return Calibrate(f"calibration of {name.replace('_', ' ')}", self.root / name, self.dataset, scores)

    def recipe(self) -> list[str]:
        """The commands in order, as one would type them in a checkout's root."""
        configurations = Path("lerobot_gloves/demo")
        here = Training(Path("outputs/demo"), self.demonstrations, self.steps, self.scores, configurations)
        trainings, exports = [here.train(name) for name in TRIO], [here.export(name) for name in TRIO]
        calibrations = [here.calibrate(name) for name in ADAPTERS]
        return [shlex.join(stage.words) for stage in (here.record, *trainings, *exports, *calibrations)]


def train_trio(training: Training, *, began: float) -> None:
    """Make the trio, or what is left to do of it.

    Args:
        training: What to make.
        began: When the demo began (`time.monotonic`), for the elapsed time.

    Raises:
        ChildProcessError: If a command fails.
        ValueError: If the folder holds a trio, or part of one, that was made with other settings.
    """
    root = training.root
    claim(training)

    def stage(number: int, title: str, parts: Sequence[Stage]) -> None:
        now, done = clock(time.monotonic() - began), all(part.done for part in parts)
        print(f"[{now}] training {number} of 4, {title}{': already done' if done else ''}", flush=True)
        make(parts, root / "logs", began=began)

    exports = {name: training.export(name) for name in TRIO}
    stage(1, f"{training.demonstrations} demonstrations", [training.record])
    # The copilot first: it takes the longest, and the other two fit beside it.
    trainings = [training.train(name) for name in reversed(TRIO) if not exports[name].done]
    stage(2, "agent, expert flow and copilot", trainings)
    stage(3, "averaged weights in half precision", list(exports.values()))
    stage(4, "calibration", [training.calibrate(name) for name in ADAPTERS])
    with whole(root / "README.md") as part:
        part.write_text(describe(root, TRIO, training.recipe()))


def claim(training: Training) -> None:
    """Note in the folder what is made there.

    Raises:
        ValueError: If it is another trio's.
    """
    settings = {
        "demonstrations": training.demonstrations,
        "steps": training.steps,
        "scores": list(training.scores),
        **{name: (training.configurations / f"{name}.yaml").read_text() for name in TRIO},
    }
    file = training.root / "training.json"
    if file.exists():
        found = json.loads(file.read_text())
        different = ", ".join(key for key in settings if found.get(key) != settings[key])
        if different:
            raise ValueError(
                f"{training.root} holds a trio that was made with another setting of {different}: "
                "choose another --output_dir or delete that folder"
            )
    training.root.mkdir(parents=True, exist_ok=True)
    with whole(file) as part:
        part.write_text(json.dumps(settings, indent=2))
