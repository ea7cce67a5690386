"""What a gate sees of each fault, and how often it stops a healthy agent, by score: for one task of the benchmark.

The raw agent plays, and every score judges each of its chunks beside it; nothing is edited. The area under the ROC
curve is the probability that a chunk which the perturbation changed is judged worse than one of the healthy agent's
(0.5 is chance); the share behind it is how many of them the gate turns away at its alpha. Of the healthy agent are
given the chunks that are turned away, and the episodes in which any is.

Unless it is given, a score's alpha is the largest of `ALPHAS` at which at most 5 % of the healthy agent's chunks are
turned away: to be chosen on validation seeds, and given for others.

    python scripts/study_gate.py --task=keypad --adapter=<its copilot, calibrated for all the scores>
"""

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
import yaml
from lerobot.envs import EnvConfig
from lerobot.policies import get_policy_class
from torch import Tensor

import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.conformal import JointGate, auroc
from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.evaluation.seeds import SPLITS, environment_seeds, policy_seed
from lerobot_gloves.specification import parse_all, specification
from lerobot_gloves.system.text import markdown_table

SCORES = ("reverse:steps=1", "reverse:steps=5", "residual", "correction")
TESTS = (*SCORES, "reverse:steps=1+correction", "reverse:steps=5+correction")
ALPHAS = (0.2, 0.15, 0.1, 0.05, 0.02, 0.01)
MOST = 0.05
"""At most this share of the healthy agent's chunks may be turned away."""
EPISODES = 30


@dataclass(frozen=True)
class Judged:
    """The chunks of one perturbation, those of full length.

    Attributes:
        scores: Of each chunk, by the score's specification, (n,).
        perturbed: Whether the perturbation changed it, bool (n,).
        episode: Which episode it is of, (n,).
        success: The share of the episodes that succeeded.
    """

    scores: Mapping[str, Tensor]
    perturbed: Tensor
    episode: Tensor
    success: float


class Test:
    """Scores and their calibration.

    Args:
        text: The scores, joined by `+`.
        calibration: Their calibration.
    """

    def __init__(self, text: str, calibration: Calibration):
        self.names = written_out(text)
        self._tables = [calibration.of(name, len(calibration.scores[name])) for name in self.names]

    def stops(self, judged: Judged, alpha: float) -> Tensor:
        """Which chunks are turned away, bool (n,)."""
        return ~JointGate(self._tables, alpha).admits(self._of(judged))

    def ranks(self, judged: Judged) -> Tensor:
        """The chunks (n,), the worse the larger: by the score, or by the p-value of several."""
        scores = self._of(judged)
        return scores[0] if len(scores) == 1 else -JointGate(self._tables).p_value(scores)

    def _of(self, judged: Judged) -> Tensor:
        return torch.stack([judged.scores[name] for name in self.names])


def written_out(text: str) -> list[str]:
    """Specifications of scores with all their options, as a log and a calibration name them."""
    known = get_policy_class("gloves_copilot").scores  # type: ignore[attr-defined]
    return [specification(score, known) for score in parse_all(text, known, "score")]


def judge(env: EnvConfig, agent: str, perturbation: str, adapter: Path, split: str, seeds: int) -> Judged:
    """Play the raw agent, with every score looking on."""
    lines, successes = [], []
    for seed in range(seeds):
        with TemporaryDirectory() as folder:
            log = Path(folder) / "log.jsonl"
            looking_on = {"adapter": str(adapter), "method": "none", "score": "+".join(SCORES), "log": log}
            wrapped = load_agent(env, agent, perturbation, policy_seed(split, seed), **looking_on)
            with environments(env, EPISODES) as vector, wrapped.autocast:
                played = rollout(vector, wrapped, environment_seeds(split, seed, EPISODES))
            successes += [episode.success for episode in played]
            for line in map(json.loads, log.read_text().splitlines()):
                lines.append({**line, "episode": EPISODES * seed + line["episode"]})
    full, names = max(line["length"] for line in lines), written_out("+".join(SCORES))
    lines = [line for line in lines if line["length"] == full]
    return Judged(
        {name: torch.tensor([line["scores"][name] for line in lines]).double() for name in names},
        torch.tensor([line.get("perturbed", False) for line in lines]),
        torch.tensor([line["episode"] for line in lines]),
        sum(successes) / len(successes),
    )


def table(healthy: Judged, faults: Mapping[str, Judged], calibration: Calibration, alphas: Mapping[str, float]) -> str:
    """A line for every test, of what it sees at its alpha; `alphas` are those that are not to be chosen here."""
    header = ["score", "alpha", "healthy chunks", "healthy episodes"]
    header += [f"{name} ({100 * judged.success:.0f} %)" for name, judged in faults.items()]
    lines = []
    for text in TESTS:
        test = Test(text, calibration)
        fitting = [alpha for alpha in ALPHAS if test.stops(healthy, alpha).double().mean() <= MOST]
        alpha = alphas.get(text, (fitting or ALPHAS[-1:])[0])
        stopped = test.stops(healthy, alpha)
        touched = len(healthy.episode[stopped].unique()) / len(healthy.episode.unique())
        line = [text, f"{alpha:g}", f"{100 * stopped.double().mean():.1f} %", f"{100 * touched:.0f} %"]
        for judged in faults.values():
            changed = judged.perturbed
            power = test.stops(judged, alpha)[changed].double().mean()
            line.append(f"{auroc(test.ranks(healthy), test.ranks(judged)[changed]):.2f} ({100 * power:.0f} %)")
        lines.append(line)
    return markdown_table([header, *lines])


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", required=True, help="name of a file in configs/bench/")
    parser.add_argument("--adapter", type=Path, required=True, help="folder of the copilot that scores")
    parser.add_argument("--split", default="validation", choices=sorted(SPLITS))
    parser.add_argument("--seeds", type=int, default=2, help=f"of {EPISODES} episodes each; by default 2")
    parser.add_argument("--alphas", nargs="*", default=[], help="SCORE=ALPHA of scores whose alpha is chosen already")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    (setting,) = yaml.safe_load(Path(f"configs/bench/{arguments.task}.yaml").read_text())["tasks"].values()
    options = dict(setting["env"])
    env = EnvConfig.get_choice_class(options.pop("type"))(**options)
    calibration = Calibration.load(arguments.adapter)
    if calibration is None:
        parser.error(f"{arguments.adapter} is not calibrated: run gloves calibrate --scores='[{', '.join(SCORES)}]'")
    judged = {
        name: judge(env, setting["agent"], perturbation, arguments.adapter, arguments.split, arguments.seeds)
        for name, perturbation in setting["perturbations"].items()
        if "paper" not in name
    }
    alphas = {text: float(alpha) for text, _, alpha in (pair.rpartition("=") for pair in arguments.alphas)}
    healthy = judged.pop("none")
    count, seeds = arguments.seeds * EPISODES, "test" if arguments.split == "test" else "validation"
    print(f"{arguments.task}, {count} episodes a fault on {seeds} seeds; behind a fault: the raw agent's success;")
    print("area under the ROC curve (share of the changed chunks that is turned away)\n")
    print(table(healthy, judged, calibration, alphas))


if __name__ == "__main__":
    main()
