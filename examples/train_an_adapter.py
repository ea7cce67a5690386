"""Train an expert flow on demonstrations and calibrate it: what `lerobot-train` and `gloves` do for any dataset.

Tiny here, so that it takes a minute; the last line says how to use what comes out.

    python examples/train_an_adapter.py [FOLDER]
"""

import subprocess
import sys
from pathlib import Path


def run(program: str, *options: str) -> None:
    """A command of this Python environment."""
    print(" ".join([program, *options]), flush=True)
    subprocess.run([Path(sys.executable).with_name(program), *options], check=True)


def main(folder: Path) -> None:
    """Record, train, calibrate."""
    data = ["--dataset.repo_id=me/slalom", f"--dataset.root={folder / 'slalom'}"]
    task = ["--env.type=gloves_slalom", "--env.obs_type=state", "--env.mode=0 2 3"]
    run("gloves", "record", *task, *data, "--dataset.num_episodes=12", "--num_workers=1")
    small = ["--policy.width=32", "--policy.context_dim=32", "--policy.depth=1", "--steps=30", "--batch_size=8"]
    run(
        "lerobot-train",
        "--policy.type=gloves_expert_flow",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        *data,
        "--dataset.eval_split=0.25",  # what is held out calibrates the gate
        "--num_workers=0",
        f"--output_dir={folder / 'training'}",
        *small,
    )
    adapter = folder / "training" / "checkpoints" / "last" / "pretrained_model"
    run("gloves", "calibrate", f"--policy.path={adapter}", *data)
    print(f"now: lerobot-eval --policy.path=<your policy> --policy.wrap=gloves --policy.adapter={adapter} ...")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("outputs/example"))
