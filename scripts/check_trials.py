"""Verdicts of gloves check that are known beforehand: a trained flow, one hardly trained, and those of another task.

Ten times half of a task's held-out episodes are drawn, with other wrong chunks each time, and a flow checked on them.
On Slalom: the demo's flow, which is usable; the same after 30 steps of its training, which is not; and one of Keypad,
which is not either. On Keypad: the demo's flow, which is not usable there, and Keypad's own, of which nobody knows how
much it is worth: it is short of training.

An adapter of another task has most often other shapes, and is refused by name. So Keypad's demonstrations are cut to
the shapes of Slalom's, as they are with one robot and two tasks: the stylus' motion in the plane, its set-point and
position there, and of what is around it the nine lights and three of the travels. A flow is trained on them as the
demo's is, in a third of the steps.

    lerobot-train --config_path=lerobot_gloves/demo/expert_flow.yaml --dataset.root=outputs/datasets/slalom_state \
        --steps=30 --output_dir=outputs/thirty
    python scripts/check_trials.py --data=outputs/datasets --thirty=outputs/thirty

What is done is kept in --work, and a second run goes on from there.
"""

import argparse
import json
import logging
import subprocess
import time
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset

import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.on_data import open_adapter
from lerobot_gloves.checkpoints.telling import tell, verdict
from lerobot_gloves.evaluation.agent import quiet
from lerobot_gloves.scores import ReverseScore
from lerobot_gloves.system.text import markdown_table

DEMO = Path(__file__).parents[1] / "lerobot_gloves" / "demo"
SLALOM, KEYPAD = "gloves/slalom_state", "gloves/keypad_flat"
SCORES = {"reverse:steps=1": ReverseScore(steps=1), "reverse:steps=5": ReverseScore(steps=5)}
DRAWS, CHUNKS, BATCH, STEPS = 10, 400, 64, 2000
CUT = {
    "action": ("action", [0, 1]),
    "observation.state": ("observation.state", [3, 4, 0, 1]),
    "observation.environment_state": ("observation.environment_state", [*range(9, 18), *range(3)]),
}
"""Keypad's features that stand in for Slalom's, and which of their entries."""


def cut(keypad: Path, root: Path) -> None:
    """Write Keypad's demonstrations in Slalom's shapes to `root`."""
    source = LeRobotDataset("gloves/keypad_state", root=keypad)
    columns = source.hf_dataset.with_format("numpy")[:]
    features = {
        key: {"dtype": "float32", "shape": (len(entries),), "names": [f"{key}_{i}" for i in entries]}
        for key, (_, entries) in CUT.items()
    }
    dataset = LeRobotDataset.create(KEYPAD, fps=source.fps, root=root, features=features, use_videos=False)
    for row, episode in enumerate(columns["episode_index"]):
        frame: dict[str, Any] = {key: columns[name][row][entries] for key, (name, entries) in CUT.items()}
        dataset.add_frame(frame | {"task": "press"})
        if row + 1 == len(columns["episode_index"]) or columns["episode_index"][row + 1] != episode:
            dataset.save_episode()
    dataset.finalize()


def train(root: Path, output: Path) -> None:
    """Train a flow on what `cut` wrote."""
    command = ["lerobot-train", f"--config_path={DEMO / 'expert_flow.yaml'}", f"--dataset.repo_id={KEYPAD}"]
    command += [f"--dataset.root={root}", f"--steps={STEPS}", f"--save_freq={STEPS}", f"--output_dir={output}"]
    subprocess.run([*command, "--policy.device=cpu"], check=True, stdout=subprocess.DEVNULL)


def trial(checkpoint: Path, dataset: HeldOutConfig, draw: int) -> dict[str, Any]:
    """Check an adapter once on half of a dataset's held-out episodes: whether it is usable, and why."""
    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.pretrained_path, config.device = checkpoint, "cpu"
    began = time.monotonic()
    with quiet():
        opened = open_adapter(config, dataset, None)
        chunks = tell(opened, SCORES, CHUNKS, BATCH, kinds=["another moment"], seed=draw)
    usable, line = verdict(chunks)
    area, low, _ = max((chunks.area(name, "another moment") for name in SCORES), key=lambda one: one[1])
    seconds = round(time.monotonic() - began, 1)
    return {"usable": usable, "line": line, "area": area, "low": low, "seconds": seconds}


def halves(checkpoint: Path, dataset: HeldOutConfig) -> list[list[int]]:
    """Ten draws of half of the episodes that the checkpoint's training held out."""
    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.pretrained_path, config.device = checkpoint, "cpu"
    with quiet():
        episodes = torch.tensor(open_adapter(config, dataset, None).episodes)
    draws = (torch.randperm(len(episodes), generator=torch.Generator().manual_seed(draw)) for draw in range(DRAWS))
    return [sorted(episodes[draw[: len(episodes) // 2]].tolist()) for draw in draws]


def main() -> None:
    """Prepare what is missing, play the trials that are missing, print all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder of slalom_state and keypad_state")
    parser.add_argument("--thirty", type=Path, required=True, help="output_dir of the training of 30 steps")
    parser.add_argument("--work", type=Path, default=Path("outputs/check_trials"), help="where to keep what is done")
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    flat, trained, kept = (arguments.work / name for name in ("keypad_flat", "keypad_flow", "trials.jsonl"))
    arguments.work.mkdir(parents=True, exist_ok=True)
    if not flat.exists():
        cut(arguments.data / "keypad_state", flat)
    last = Path("checkpoints", "last", "pretrained_model")
    if not (trained / last).exists():
        train(flat, trained)
    shipped, keypads = DEMO / "expert_flow", trained / last
    slalom = HeldOutConfig(SLALOM, root=str(arguments.data / "slalom_state"))
    pressed = HeldOutConfig(KEYPAD, root=str(flat))
    held_out = {SLALOM: halves(shipped, slalom), KEYPAD: halves(keypads, pressed)}
    plan = {
        "the demo's flow": (shipped, slalom, True),
        "the same after 30 steps": (arguments.thirty / last, slalom, False),
        "Keypad's flow": (keypads, slalom, False),
        "the demo's flow, on Keypad": (shipped, pressed, False),
        "Keypad's flow, on Keypad": (keypads, pressed, None),
    }
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(row["flow"], row["draw"]) for row in rows}
    for name, (checkpoint, dataset, _) in plan.items():
        for draw, episodes in enumerate(held_out[dataset.repo_id]):
            if (name, draw) in done:
                continue
            config = HeldOutConfig(dataset.repo_id, root=dataset.root, episodes=episodes)
            rows.append({"flow": name, "draw": draw, **trial(checkpoint, config, draw)})
            with kept.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    table = [["flow", "is usable", "found usable", "verdicts right", "area, least to most", "at least, least to most"]]
    for name, (_, _, usable) in plan.items():
        mine = [row for row in rows if row["flow"] == name]
        areas, lows = (sorted(row[key] for row in mine) for key in ("area", "low"))
        right = sum(row["usable"] == usable for row in mine)
        table.append(
            [
                name,
                {True: "yes", False: "no", None: "not known"}[usable],
                f"{sum(row['usable'] for row in mine)} of {len(mine)}",
                "" if usable is None else f"{right} of {len(mine)}",
                f"{areas[0]:.2f} to {areas[-1]:.2f}",
                f"{lows[0]:.2f} to {lows[-1]:.2f}",
            ]
        )
    print(markdown_table(table))


if __name__ == "__main__":
    main()
