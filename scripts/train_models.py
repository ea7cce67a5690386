"""Make all models that a task's benchmark needs, from nothing: `python scripts/train_models.py --task=keypad`.

Demonstrations, agent, expert flow and the two baselines; then the agent's own proposals under each perturbation of
configs/bench/<task>.yaml, and the align flow on all of them; calibrations. What that file does not name is left out.
Run again, it goes on where it stopped. Everything goes to outputs/, what each command prints to outputs/<task>/logs/.
"""

import argparse
import json
import shutil
import time
from pathlib import Path

import yaml

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_gloves.demo.training import PROGRESS, is_recorded, steps_done
from lerobot_gloves.recording.sources import SOURCES
from lerobot_gloves.system.processes import Job, console_script, run

MODELS = ("agent", "expert_flow", "ddpm_assist", "csa_teacher", "csa_student", "align_flow")
PROPOSALS = {"charger": 100}
"""Episodes of the agent's proposals under each perturbation, where that is not what `gloves record` makes: with fewer
of them more of what the align flow learns is the expert's, and there half a millimetre decides."""
SCORES = '--scores=["reverse:steps=1", "reverse:steps=5"]'


class Models:
    """The commands that make one task's models.

    Args:
        task: Name of its file in configs/bench/.
        steps: Optimiser steps of each training; None for what the configurations say.
        num_workers: Processes of a recording.
    """

    def __init__(self, task: str, steps: int | None, num_workers: int) -> None:
        self.task, self.steps, self.num_workers = task, steps, num_workers
        self.root = Path("outputs") / task
        benchmark = Path(f"configs/bench/{task}.yaml").read_text()
        (setting,) = yaml.safe_load(benchmark)["tasks"].values()
        # Slalom's agent and expert flow ship with the package; a student has a teacher, which no benchmark names.
        self.needed = [m for m in MODELS if f"{self.root}/{m.replace('teacher', 'student')}/" in benchmark]
        self.config = setting["env"]["type"].removeprefix("gloves_")
        self.env = [f"--env.{key}={json.dumps(value).strip('"')}" for key, value in setting["env"].items()]
        self.agent = setting["agent"]
        self.perturbations = {k: v for k, v in setting["perturbations"].items() if k in SOURCES}

    def checkpoint(self, model: str) -> Path:
        return self.root / model / "checkpoints" / "last" / "pretrained_model"

    @staticmethod
    def dataset(name: str) -> list[str]:
        return [f"--dataset.repo_id=gloves/{name}", f"--dataset.root=outputs/datasets/{name}"]

    def job(self, label: str, program: str, *options: str) -> Job:
        log = self.root / "logs" / f"{label.replace(' ', '_')}.log"
        return Job(label, [console_script(program), *options], log, PROGRESS)

    def record(self, kind: str, *options: str) -> list[Job]:
        """Demonstrations, or an agent's proposals."""
        name = f"{self.task}_{kind}"
        root = Path("outputs/datasets") / name
        if is_recorded(root):
            return []
        workers = f"--num_workers={self.num_workers}"
        return [self.job(f"recording {kind}", "gloves", "record", *self.env, *self.dataset(name), *options, workers)]

    def record_proposals(self, source: str, perturbation: str) -> list[Job]:
        """What the agent proposes under a perturbation."""
        options = [f"--agent={self.agent}", f"--perturbation={perturbation}"]
        if self.task in PROPOSALS:
            options.append(f"--dataset.num_episodes={PROPOSALS[self.task]}")
        return self.record(f"agent_{source}", *options)

    def train(self, model: str, data: str = "state", *options: str) -> list[Job]:
        """A training run, from its last checkpoint on if it has one."""
        folder, last = self.root / model, self.checkpoint(model)
        source = Path(f"configs/cpu/{self.config}_{model}.yaml")
        wanted = self.steps or yaml.safe_load(source.read_text())["steps"]
        if done := steps_done(folder):
            if done >= wanted:
                return []
            source, options = last / "train_config.json", ("--resume=true",)
        else:
            shutil.rmtree(folder, ignore_errors=True)
        data_options = self.dataset(f"{self.task}_{data}")
        command = (f"--config_path={source}", *data_options, f"--output_dir={folder}", f"--steps={wanted}", *options)
        return [self.job(model, "lerobot-train", *command)]

    def calibrate(self, model: str, data: str = "state") -> list[Job]:
        path = self.checkpoint(model)
        if (path / CALIBRATION_NAME).is_file():
            return []
        options = (f"--policy.path={path}", *self.dataset(f"{self.task}_{data}"), SCORES)
        return [self.job(f"calibration of {model}", "gloves", "calibrate", *options)]

    def merge(self) -> list[Job]:
        """Demonstrations and proposals in one dataset."""
        target = f"{self.task}_align"
        if (Path("outputs/datasets") / target / "meta" / "info.json").is_file():
            return []
        names = [f"{self.task}_{kind}" for kind in ("state", *(f"agent_{source}" for source in self.perturbations))]
        return [
            self.job(
                "merging",
                "lerobot-edit-dataset",
                "--operation.type=merge",
                f"--operation.repo_ids={json.dumps([f'gloves/{name}' for name in names])}",
                f"--operation.roots={json.dumps([f'outputs/datasets/{name}' for name in names])}",
                f"--new_repo_id=gloves/{target}",
                f"--new_root=outputs/datasets/{target}",
            )
        ]

    def make(self, wanted: list[str]) -> None:
        """Run whatever is not there yet of the models `wanted`."""
        began = time.monotonic()
        wanted = [model for model in self.needed if model in wanted]
        run(self.record("state"), began=began)
        run([job for model in wanted if model in MODELS[:4] for job in self.train(model)], began=began)
        after = self.calibrate("expert_flow") if "expert_flow" in wanted else []
        if "csa_student" in wanted:
            after += self.train("csa_student", "state", f"--policy.teacher={self.checkpoint('csa_teacher')}")
        run(after, began=began)
        if "align_flow" not in wanted:
            return
        for source, perturbation in self.perturbations.items():
            run(self.record_proposals(source, perturbation), began=began)
        run(self.merge(), began=began)
        run(self.train("align_flow", "align"), began=began)
        run(self.calibrate("align_flow", "align"), began=began)


def main() -> None:
    """Parse the arguments and make the models."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    stems = {path.stem for path in Path("configs/bench").glob("*.yaml")}
    tasks = sorted(stem for stem in stems if not stem.endswith(("_search", "_chosen")))
    parser.add_argument("--task", required=True, choices=tasks)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS), help="which; by default all")
    parser.add_argument("--steps", type=int, help="optimiser steps of each training, instead of the configurations'")
    parser.add_argument("--num_workers", type=int, default=2, help="processes of a recording")
    arguments = parser.parse_args()
    Models(arguments.task, arguments.steps, arguments.num_workers).make(arguments.models)


if __name__ == "__main__":
    main()
