"""Whether two checkouts play the same episodes, bit for bit: demonstrations of every task, and cells of Slalom.

git worktree add outputs/before <commit>
python scripts/same_episodes.py --before=outputs/before
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

TASKS = ("slalom", "keypad", "can", "charger")
DEMONSTRATIONS = 3
PAIR = "lerobot_gloves/demo"
MATRIX = f"""
episodes: 24
batch_size: 24
tasks:
  slalom:
    env: {{type: gloves_slalom, obs_type: state}}
    agent: {PAIR}/agent
    perturbations: {{laggy: "laggy:p=0.2", noised: "noised:sigma=0.0075", slow: "slow:alpha=0.25,p=0.75"}}
    methods:
      agent: {{editor: none}}
      FPAS: {{adapter: {PAIR}/expert_flow, editor: "fpas:sigma=0.2,align=0.0", score: "reverse:steps=1"}}
      FEEG+gate:
        {{adapter: {PAIR}/expert_flow, editor: "feeg:start=0.3,align=0.1", gate: true, score: "reverse:steps=5"}}
"""


def play(checkout: Path, folder: Path) -> None:
    """Record and bench with the code of a checkout, in this Python environment."""
    path = os.pathsep.join([str(checkout), str(checkout / "policies")])
    settings = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}

    def gloves(*options: str) -> None:
        command = [sys.executable, "-c", "from lerobot_gloves.commands import main; main()", *options]
        subprocess.run(command, check=True, cwd=checkout, env=settings, capture_output=True)

    for task in TASKS:
        data = [f"--dataset.repo_id=me/{task}", f"--dataset.root={folder / task}"]
        gloves(
            "record",
            f"--env.type=gloves_{task}",
            "--env.obs_type=state",
            *data,
            f"--dataset.num_episodes={DEMONSTRATIONS}",
        )
    (folder / "matrix.yaml").write_text(MATRIX)
    gloves("bench", f"--config_path={folder / 'matrix.yaml'}", f"--output_dir={folder / 'rows'}", "--num_workers=1")


def episodes(file: Path) -> list[dict[str, Any]]:
    """A row's episodes without what no two runs have alike, the time they took."""
    kept = json.loads(file.read_text())["episodes"]
    return [{key: value for key, value in one.items() if key != "milliseconds"} for one in kept]


def compare(before: Path, after: Path) -> Iterator[tuple[str, bool]]:
    """What was compared, and whether it is the same."""
    for task in TASKS:
        files = sorted(file.relative_to(before) for file in (before / task / "data").rglob("*.parquet"))
        same = all(pq.read_table(before / file).equals(pq.read_table(after / file)) for file in files)
        yield f"{task}: {DEMONSTRATIONS} demonstrations", same and bool(files)
    for file in sorted((before / "rows").glob("*.json")):
        yield f"{file.stem}: 24 episodes", episodes(file) == episodes(after / "rows" / file.name)


def main() -> None:
    """Play both, compare, and exit with status 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True, help="the other checkout's folder")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        played = [Path(folder) / name for name in ("before", "after")]
        for checkout, to in zip((arguments.before, Path(__file__).parents[1]), played, strict=True):
            to.mkdir()
            play(checkout.resolve(), to)
        found = list(compare(*played))
    print("\n".join(f"{name}: {'the same' if same else 'DIFFERENT'}" for name, same in found))
    sys.exit(0 if all(same for _, same in found) else 1)


if __name__ == "__main__":
    main()
