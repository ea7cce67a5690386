"""How well each score tells an expert's chunks from the same chunks made worse, and what it costs, in one run.

The demo's expert flow for Slalom scores chunks of demonstrations that are recorded here, on validation seeds: as they
are, and noised, replayed (the chunk before in the place of this one), slowed and shifted, every one of them. Strengths
are below the benchmark's, where most scores see everything. For each, the area under the ROC curve over all chunks (0.5
is chance), and the share that a threshold which turns away 5 % of the clean chunks sees. Scores run in turn on the same
batch; the medians of their milliseconds and of their ratios to the first one's are printed, since in the latter a
machine's mood cancels.

    OMP_NUM_THREADS=1 python scripts/benchmark_scores.py
"""

import argparse
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from benchmark_editing import seconds
from lerobot.configs import PreTrainedConfig
from lerobot.envs import EnvConfig
from torch import Tensor

import lerobot_gloves.tasks
import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.adapter import BoundAdapter
from lerobot_gloves.checkpoints.loading import LoadedPolicy, load_policy
from lerobot_gloves.conformal import auroc
from lerobot_gloves.evaluation.seeds import VALIDATION
from lerobot_gloves.perturbations import Noised, Shift, Slow
from lerobot_gloves.recording.demonstrations import demonstrate
from lerobot_gloves.scores import SCORES, Score
from lerobot_gloves.specification import parse
from lerobot_gloves.system.text import markdown_table

EXPERT_FLOW = Path(lerobot_gloves.__file__).parent / "demo" / "expert_flow"
SCORED = ("reverse:steps=1", "reverse:steps=5", "residual", "likelihood", "selfnormalised")
LEVEL = 0.05
"""Share of the clean chunks that the threshold turns away."""
type Chunks = tuple[dict[str, Tensor], Tensor, Tensor]
"""Observations by their key, the chunks (N, T, A) that the expert made of them, and the chunks before those."""


def demonstrations(count: int, inputs: Sequence[str], length: int) -> Chunks:
    """Chunks of `count` demonstrations, one after another, each but an episode's first and its rest."""
    config = EnvConfig.get_choice_class("gloves_slalom")(obs_type="state")
    env = gym.make(config.gym_id, disable_env_checker=True, **config.demonstration_kwargs)
    rows: dict[str, list[np.ndarray]] = {key: [] for key in inputs}
    clean, before = [], []
    for seed in range(VALIDATION, VALIDATION + count):
        frames = demonstrate(config, env, seed).frames
        action = frames["action"]
        for start in range(length, len(action) - length + 1, length):
            clean.append(action[start : start + length])
            before.append(action[start - length : start])
            for key in inputs:
                rows[key].append(frames[key][start])
    env.close()
    observation = {key: torch.as_tensor(np.stack(found)).float() for key, found in rows.items()}
    return observation, torch.as_tensor(np.stack(clean)).float(), torch.as_tensor(np.stack(before)).float()


def made_worse(clean: Tensor, before: Tensor) -> dict[str, Tensor]:
    """The chunks under each name, raw."""
    perturbations = {
        "noised": Noised(sigma=0.001),
        "slowed": Slow(alpha=0.8, p=1),
        "shifted": Shift(dim=1, alpha=0.001, p=1),
    }
    for perturbation in perturbations.values():
        perturbation.reset(len(clean), seed=0)
    return {"replayed": before, **{name: perturbation(clean) for name, perturbation in perturbations.items()}}


def power(clean: Tensor, worse: Tensor) -> float:
    """Share of the worse chunks above the threshold of the clean ones."""
    return (worse > clean.quantile(1 - LEVEL)).double().mean().item()


def compare(loaded: LoadedPolicy, chunks: Chunks, specifications: Sequence[str], batch: int, repeats: int) -> str:
    """The table of all scores."""
    observation, clean, before = chunks
    kinds = {"clean": clean, **made_worse(clean, before)}
    normal = {name: loaded.preprocess({**observation, "action": chunk})["action"] for name, chunk in kinds.items()}
    bound = loaded.policy.bind(loaded.preprocess({**observation, "action": clean}))
    scores = {text: parse(text, SCORES, "score") for text in specifications}
    some = bound.select(torch.arange(len(clean)) < batch)
    taken = side_by_side(some, normal["clean"][:batch], scores, repeats)
    lines = []
    for text, score in scores.items():
        first = bound.evaluations
        found = {name: bound.score(chunk, score) for name, chunk in normal.items()}
        evaluations = (bound.evaluations - first) // len(normal)
        seen = [f"{auroc(found['clean'], found[n]):.2f} ({100 * power(found['clean'], found[n]):.0f} %)" for n in kinds]
        milliseconds = 1000 * statistics.median(one[text] for one in taken) / batch
        ratio = statistics.median(one[text] / one[specifications[0]] for one in taken)
        lines.append([text, *seen[1:], str(evaluations), f"{milliseconds:.2f}", f"{ratio:.1f}"])
    header = ["score", *list(kinds)[1:], "evaluations", "milliseconds a chunk", "times the first"]
    return markdown_table([header, *lines])


def side_by_side(bound: BoundAdapter, chunk: Tensor, scores: dict[str, Score], repeats: int) -> list[dict[str, float]]:
    """Seconds that each score takes on a batch, all in turn, `repeats` times."""
    runs: dict[str, Callable[[], object]] = {
        text: lambda score=score: bound.score(chunk, score)  # type: ignore[misc]
        for text, score in scores.items()
    }
    for run in runs.values():
        run()
    return [{text: seconds(run) for text, run in runs.items()} for _ in range(repeats)]


def main() -> None:
    """Record, score and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scores", nargs="*", default=list(SCORED), help="specifications; by default every score")
    parser.add_argument("--demonstrations", type=int, default=12, help="episodes to record; by default 12")
    parser.add_argument("--batch", type=int, default=30, help="chunks side by side where time is taken")
    parser.add_argument("--repeats", type=int, default=5, help="times that each score is timed")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config = PreTrainedConfig.from_pretrained(EXPERT_FLOW)
    config.pretrained_path = EXPERT_FLOW
    loaded = load_policy(config, "cpu")
    loaded.policy.requires_grad_(False)
    chunks = demonstrations(arguments.demonstrations, list(config.input_features), config.chunk_size)
    print(
        f"{len(chunks[1])} chunks of {arguments.demonstrations} demonstrations, one thread, torch {torch.__version__}"
    )
    print(f"area under the ROC curve (seen where {100 * LEVEL:.0f} % of the clean chunks are turned away)\n")
    print(compare(loaded, chunks, arguments.scores, arguments.batch, arguments.repeats))


if __name__ == "__main__":
    main()
