"""Make all models that a task's benchmark needs, from nothing: `python scripts/train_models.py --task=keypad`.

Demonstrations, agent, expert flow, copilot and the two baselines; then the agent's own proposals under each
perturbation of configs/bench/<task>.yaml, and the align flow on all of them; calibrations. What that file does not name
is left out.
Run again, it goes on where it stopped. Everything goes to outputs/, what each command prints to outputs/<task>/logs/.
Each model's folder, outputs/<task>/<model>/checkpoints/last/pretrained_model, then holds what belongs on the Hub:
weights, processors, calibration, card. `--push=USER` uploads them all as USER/gloves_<task>_<model>.

`--seed=1` trains the correctors once more, with other random numbers on the same data, to outputs/<task>_seed1/: those
of configs/ablations/training_seeds.yaml.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import yaml
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_gloves.checkpoints.card import CARD_NAME
from lerobot_gloves.checkpoints.publishing import push
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.demo.pipeline import Calibrate, Card, Dataset, Merge, Record, Stage, Train, make
from lerobot_gloves.recording.sources import SOURCES

MODELS = ("agent", "expert_flow", "copilot", "ddpm_assist", "csa_teacher", "csa_student", "align_flow")
PROPOSALS = {"charger": 100}
"""Episodes of the agent's proposals under each perturbation, where that is not what `gloves record` makes: with fewer
of them more of what the align flow learns is the expert's, and there half a millimetre decides."""
SCORES = ("reverse:steps=1", "reverse:steps=5")
SEEDS = Path("configs/ablations/training_seeds.yaml")

# A tenth of a second: what a policy errs by adds up until it looks again, and half a millimetre is too much.
_SHORT = {"policy.chunk_size": 2, "policy.n_action_steps": 2}
_PAIR = {"policy.width": 128, "policy.depth": 4, "policy.context_dim": 256, "policy.samples_per_item": 8}
# The size of the demo's models, which the benchmark corrects.
_BASELINE = {
    "policy.width": 64,
    "policy.context_dim": 96,
    "policy.samples_per_item": 2,
    "batch_size": 32,
    "steps": 6000,
}


def _with_cameras(task: str) -> dict[str, dict[str, Any]]:
    """Options of models that see images: the correctors look through the expert flow's encoders, as they are."""
    eyes = {"policy.backbone_dtype": "bfloat16", "policy.pretrained_backbone_weights": "null"}
    seen = f"outputs/{task}/expert_flow/checkpoints/last/pretrained_model"
    borrowed = {**eyes, "policy.pretrained_backbone_weights": seen, "policy.optimizer_lr_backbone": 0.0}
    first = {**eyes, "policy.samples_per_item": 8, "policy.optimizer_lr": 5e-4, "save_freq": 2000, "steps": 8000}
    return {
        "agent": first,
        "expert_flow": first,
        "copilot": borrowed,
        "csa_teacher": borrowed,
        "csa_student": {**eyes, "policy.optimizer_lr_backbone": 0.0},
    }


OPTIONS: dict[str, dict[str, dict[str, Any]]] = {
    **{task: _with_cameras(task) for task in ("slalom_pixels", "can_pixels")},
    "slalom": {
        **dict.fromkeys(("agent", "expert_flow"), _PAIR | {"batch_size": 8, "steps": 15000, "save_freq": 5000}),
        **dict.fromkeys(("ddpm_assist", "csa_teacher", "csa_student"), _BASELINE),
        "align_flow": {"policy.samples_per_item": 2, "batch_size": 32},
    },
    "charger": {
        "agent": _SHORT | {"policy.samples_per_item": 2, "batch_size": 64, "steps": 15000},
        **dict.fromkeys(
            ("expert_flow", "ddpm_assist", "csa_teacher", "csa_student"),
            _SHORT | {"policy.samples_per_item": 1, "batch_size": 64, "steps": 12000},
        ),
        "align_flow": _SHORT | {"policy.samples_per_item": 1, "batch_size": 64, "steps": 15000},
        "copilot": _SHORT | {"steps": 12000},
    },
}
"""By task, or else type of environment, and model, the options of `lerobot-train` over configs/cpu/<model>.yaml."""


class Models:
    """One task's models, each a stage that knows whether it is done.

    Args:
        task: Name of its file in configs/bench/.
        steps: Optimiser steps of each training; None for what the configurations and `OPTIONS` say.
        num_workers: Processes of a recording.
        seed: Of the trainings. Those of 0 are the benchmark's, others its ablation's.
    """

    def __init__(self, task: str, steps: int | None, num_workers: int, seed: int = 0) -> None:
        self.task, self.steps, self.num_workers, self.seed = task, steps, num_workers, seed
        self.root = Path("outputs") / (f"{task}_seed{seed}" if seed else task)
        benchmark = Path(f"configs/bench/{task}.yaml").read_text()
        (setting,) = yaml.safe_load(benchmark)["tasks"].values()
        if seed:
            benchmark = SEEDS.read_text()
        # Slalom's agent and expert flow ship with the package; a student has a teacher, which no benchmark names.
        self.needed = [m for m in MODELS if f"{self.root}/{m.replace('teacher', 'student')}/" in benchmark]
        self.options = OPTIONS.get(task, OPTIONS.get(setting["env"]["type"].removeprefix("gloves_"), {}))
        self.env = [f"--env.{key}={json.dumps(value).strip('"')}" for key, value in setting["env"].items()]
        self.agent = setting["agent"]
        self.perturbations = {k: v for k, v in setting["perturbations"].items() if k in SOURCES}

    def dataset(self, kind: str) -> Dataset:
        """Demonstrations (`state`), an agent's proposals under a perturbation, or all of them merged (`align`)."""
        return Dataset(f"gloves/{self.task}_{kind}", Path("outputs/datasets") / f"{self.task}_{kind}")

    def record(self, kind: str, *options: str) -> Record:
        """Demonstrations, or an agent's proposals."""
        workers = f"--num_workers={self.num_workers}"
        return Record(f"recording {kind}", self.env, self.dataset(kind), [*options, workers])

    def record_proposals(self, source: str, perturbation: str) -> Record:
        """What the agent proposes under a perturbation."""
        options = [f"--agent={self.agent}", f"--perturbation={perturbation}"]
        if self.task in PROPOSALS:
            options.append(f"--dataset.num_episodes={PROPOSALS[self.task]}")
        return self.record(f"agent_{source}", *options)

    def train(self, model: str, data: str = "state", *options: str) -> Train:
        """A training run by the configuration of that name, with what the task has of its own."""
        own = dict(self.options.get(model, {}))
        steps = own.pop("steps", None)
        named = [f"--{name}={value}" for name, value in own.items()]
        return Train(
            model,
            Path(f"configs/cpu/{model}.yaml"),
            self.dataset(data).options,
            self.root / model,
            self.steps or steps,
            [*named, *([f"--seed={self.seed}"] if self.seed else []), *options],
        )

    def calibrate(self, model: str, data: str = "state") -> Calibrate:
        """Its scores of the episodes that its training held out."""
        scores = (*SCORES, "correction") if model == "copilot" else SCORES
        return Calibrate(f"calibration of {model}", self.train(model).checkpoint, self.dataset(data), scores)

    def merge(self) -> Merge:
        """Demonstrations and proposals in one dataset."""
        kinds = ("state", *(f"agent_{source}" for source in self.perturbations))
        return Merge("merging", [self.dataset(kind) for kind in kinds], self.dataset("align"))

    def make(self, wanted: list[str]) -> None:
        """Run whatever is not there yet of the models `wanted`."""
        began = time.monotonic()

        def together(*stages: Stage) -> None:
            make(stages, self.root / "logs", began=began)

        wanted = [model for model in self.needed if model in wanted]
        together(self.record("state"))
        for models in (MODELS[:2], MODELS[2:5]):
            together(*(self.train(model) for model in wanted if model in models))
        after: list[Stage] = [self.calibrate(model) for model in ("expert_flow", "copilot") if model in wanted]
        if "csa_student" in wanted:
            teacher = self.train("csa_teacher").checkpoint
            after.append(self.train("csa_student", "state", f"--policy.teacher={teacher}"))
        together(*after)
        if "align_flow" in wanted:
            for source, perturbation in self.perturbations.items():
                together(self.record_proposals(source, perturbation))
            together(self.merge())
            together(self.train("align_flow", "align"))
            together(self.calibrate("align_flow", "align"))
        together(*(Card(f"card of {model}", self.train(model).checkpoint) for model in wanted))

    def push(self, wanted: list[str], user: str) -> list[str]:
        """Upload the models `wanted`, each to a repository of that user; their addresses.

        Raises:
            ConnectionError: If the Hub cannot be reached, or does not take one.
            FileNotFoundError: If one is not made yet.
        """
        folders = {model: self.train(model).checkpoint for model in self.needed if model in wanted}
        calibrated = {"expert_flow", "copilot", "align_flow"}
        files = [folder / CARD_NAME for folder in folders.values()]
        files += [folder / CALIBRATION_NAME for model, folder in folders.items() if model in calibrated]
        for file in files:
            if not file.is_file():
                raise FileNotFoundError(f"there is no {file}: make the models first, make models TASK={self.task}")
        return [push(folder, f"{user}/gloves_{self.root.name}_{model}") for model, folder in folders.items()]


def main() -> None:
    """Parse the arguments and make the models."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    stems = {path.stem for path in Path("configs/bench").glob("*.yaml")}
    stems.discard("metaworld")  # whose models scripts/train_metaworld.py makes
    tasks = sorted(stem for stem in stems if not stem.endswith(("_search", "_chosen")))
    parser.add_argument("--task", required=True, choices=tasks)
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS), help="which; by default all")
    parser.add_argument("--steps", type=int, help="optimiser steps of each training, instead of the configurations'")
    parser.add_argument("--num_workers", type=int, default=2, help="processes of a recording")
    parser.add_argument("--seed", type=int, default=0, help="of the trainings, instead of the benchmark's 0")
    parser.add_argument("--push", metavar="USER", help="upload what is made to the Hub, and make nothing")
    arguments = parser.parse_args()
    register_third_party_plugins()
    models = Models(arguments.task, arguments.steps, arguments.num_workers, arguments.seed)
    if not models.needed:
        parser.error(f"{SEEDS} names no models of --task={arguments.task} and --seed={arguments.seed}")
    if arguments.push is None:
        models.make(arguments.models)
        return
    with one_line_errors("train_models.py"):
        print("\n".join(models.push(arguments.models, arguments.push)))


if __name__ == "__main__":
    main()
