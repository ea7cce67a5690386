"""What a correction takes of one robot's time, by editor and by what the robot sees: its median and 99th percentile.

One observation after another is planned under by a wrapped agent, on one thread, with networks of the sizes of
configs/cpu/ and random weights; what counts is what the wrapper itself calls a correction: the observation encoded,
the proposal scored and edited. The agent's own planning stands beside it.

    python scripts/benchmark_latency.py
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
import yaml
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import get_policy_class, make_policy_config, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from torch import Tensor

from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.recording.sources import SOURCES
from lerobot_gloves.system.text import markdown_table

CONFIGS = Path(__file__).parents[1] / "configs" / "cpu"
JOINTS, PERIOD = 7, 50.0
"""Entries of the state and of an action; milliseconds between two actions at 20 Hz."""
SEEN = {"state": (0, 0), "1 camera of 96 x 96": (1, 96), "2 of 96 x 96": (2, 96), "1 of 256 x 256": (1, 256)}
"""Numbers of cameras, and the height and width of their images."""
EDITORS: dict[str, tuple[str, dict[str, Any]]] = {
    "copilot": ("copilot", {"method": "copilot:limit=0.4"}),
    "copilot + gate": ("copilot", {"method": "copilot:limit=0.4", "gate": True, "score": "correction"}),
    "CSA": ("csa_student", {"method": "csa"}),
    "DDPM": ("ddpm_assist", {"method": "ddpm:gamma=0.3"}),
    "FEEG": ("expert_flow", {"method": "feeg"}),
    "FEEG + gate": ("expert_flow", {"method": "feeg", "gate": True, "score": "reverse:steps=5"}),
    "FPAS": ("expert_flow", {"method": "fpas"}),
    "IFAE": ("align_flow", {"method": "ifae:steps=20", "adapter_overrides": ["--agent_source=noised"]}),
}
"""By name, the adapter's configuration and the wrapper's options; every gate turns every chunk away."""


class Robot:
    """Policies of random weights for one robot, saved as a training saves them.

    Args:
        folder: Where to.
        cameras: How many it has.
        size: Height and width of their images.
    """

    def __init__(self, folder: Path, cameras: int, size: int):
        self.folder = folder
        images = {f"observation.images.{i}": PolicyFeature(FeatureType.VISUAL, (3, size, size)) for i in range(cameras)}
        vectors = {"observation.state": JOINTS, "observation.goal": 1}  # the goal is for the agent alone
        states = {key: PolicyFeature(FeatureType.STATE, (size,)) for key, size in vectors.items()}
        self.inputs = {**states, **images}
        self.outputs = {"action": PolicyFeature(FeatureType.ACTION, (JOINTS,))}

    def save(self, name: str, **more: Any) -> Path:
        """One of configs/cpu/, calibrated if it scores, unless it is there already."""
        target = self.folder / name
        if target.is_dir():
            return target
        options = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())["policy"]
        kind = options.pop("type")
        made = {"input_features": dict(self.inputs), "output_features": self.outputs, "device": "cpu"}
        config = make_policy_config(kind, **options, **made, **more, pretrained_backbone_weights=None)
        policy: Any = get_policy_class(kind)(config).eval()
        policy.save_pretrained(target)
        for pipeline in make_pre_post_processors(config, dataset_stats=self.statistics()):
            pipeline.save_pretrained(target)
        if scores := getattr(policy, "scores", {}):
            named = ["reverse:steps=1", "reverse:steps=5", *(["correction"] if "correction" in scores else [])]
            tables = {score: torch.rand(config.chunk_size, 1000) * 1e-6 for score in named}
            about = {"repo_id": "me/random", "revision": "v3.0", "episodes": (0,)}
            Calibration(scores=tables, weights=weights_hash(policy.state_dict()), **about).save(target)
        return target

    def needs(self, name: str) -> dict[str, Any]:
        """Options that a configuration leaves to the training's command or to its data."""
        if name == "csa_student":
            return {"teacher": str(self.save("csa_teacher"))}
        return {"sources": list(SOURCES)} if name == "align_flow" else {}

    def statistics(self) -> dict[str, dict[str, np.ndarray]]:
        """Of normal numbers, and images from 0 to 1."""
        shapes = {
            key: (3, 1, 1) if feature.type is FeatureType.VISUAL else feature.shape
            for key, feature in {**self.inputs, **self.outputs}.items()
        }
        ends = {"mean": 0.0, "std": 1.0, "min": -10.0, "max": 10.0}
        return {key: {end: np.full(shape, value) for end, value in ends.items()} for key, shape in shapes.items()}

    def observations(self, count: int) -> Iterator[dict[str, Tensor]]:
        """Of one robot, one after another."""
        for _ in range(count):
            yield {key: torch.rand(1, *feature.shape) for key, feature in self.inputs.items()}


def planned(robot: Robot, count: int, **options: Any) -> tuple[list[float], list[float]]:
    """Milliseconds of each correction, and of all that was planned, the first few left out."""
    config = make_policy_config("gloves", agent=str(robot.save("agent")), **options)
    policy: Any = get_policy_class("gloves")(config).eval()
    corrections, whole = [], []
    for observation in robot.observations(count + 5):
        began = time.perf_counter()
        policy.predict_action_chunk(observation)
        whole.append(1000 * (time.perf_counter() - began))
        corrections.append(0.0 if policy.correction is None else policy.correction.milliseconds)
    return corrections[5:], whole[5:]


def table(repeats: int, periods: float) -> str:
    """A line an editor: median and 99th percentile of its corrections, by what is seen."""
    columns: list[list[str]] = []
    for cameras, size in SEEN.values():
        with TemporaryDirectory() as folder:
            robot = Robot(Path(folder), cameras, size)
            cells = [_cell(planned(robot, repeats)[1], periods)]
            for name, options in EDITORS.values():
                adapter = str(robot.save(name, **robot.needs(name)))
                cells.append(_cell(planned(robot, repeats, adapter=adapter, **options)[0], periods))
            columns.append(cells)
    lines = zip(("the agent alone", *EDITORS), *columns, strict=True)
    return markdown_table([["milliseconds", *SEEN], *map(list, lines)])


def _cell(milliseconds: list[float], periods: float) -> str:
    median, high = np.quantile(milliseconds, [0.5, 0.99])
    return f"{median:.0f}, {high:.0f}" + (" (over)" if high > periods else "")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200, help="chunks that are planned for each cell")
    parser.add_argument("--period", type=float, default=PERIOD, help="milliseconds between two actions; by default 50")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    register_third_party_plugins()
    print(table(arguments.repeats, arguments.period))
    print(f"\nMedian, 99th percentile; over: longer than {arguments.period:g} ms, the period of the controller.")


if __name__ == "__main__":
    main()
