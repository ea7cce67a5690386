"""A training checkpoint to a folder small enough to ship: averaged weights in half precision, no trace of a machine.

python -m lerobot_gloves.demo.export <checkpoint>/pretrained_model <new folder>
"""

import hashlib
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from lerobot_gloves.system.files import whole

WEIGHTS = "model.safetensors"
RAW, AVERAGED = "network.", "ema."
PATHS = ("root", "output_dir", "pretrained_path", "checkpoint_path")
"""Options that name places of the machine that trained."""


def export(checkpoint: Path, folder: Path) -> None:
    """Write what inference needs of a flow's training checkpoint into a new folder.

    The weights become others by rounding, so calibrate the folder, not the checkpoint.

    Args:
        checkpoint: A `pretrained_model` folder of `lerobot-train`.
        folder: Appears at once, whole; must be missing.

    Raises:
        FileExistsError: If `folder` exists.
        FileNotFoundError: If there is no checkpoint.
        ValueError: If the checkpoint holds no averaged weights.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} exists already")
    if not (checkpoint / WEIGHTS).is_file():
        raise FileNotFoundError(f"{checkpoint} holds no {WEIGHTS}: give a pretrained_model folder of lerobot-train")
    # What is no weight, as the units of a copilot's actions, stays as exact as it is.
    kept = {
        key: _halve(value) if key.startswith(AVERAGED) else value
        for key, value in load_file(checkpoint / WEIGHTS).items()
        if not key.startswith(RAW)
    }
    if not any(key.startswith(AVERAGED) for key in kept):
        raise ValueError(f"{checkpoint / WEIGHTS} holds no averaged weights ({AVERAGED}*): is it a flow's checkpoint?")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with whole(folder) as part:
        part.mkdir()
        save_file(kept, part / WEIGHTS, metadata={"format": "pt"})
        for file in sorted(checkpoint.glob("*.json")):
            text = json.dumps(without_paths(json.loads(file.read_text())), indent=2)
            (part / file.name).write_text(text + "\n")
        for file in sorted(checkpoint.glob("policy_*.safetensors")):
            with safe_open(file, framework="pt") as tensors:
                save_file({key: tensors.get_tensor(key) for key in tensors.keys()}, part / file.name)  # noqa: SIM118


def _halve(tensor: Tensor) -> Tensor:
    """Half precision where every value fits into its range."""
    half = tensor.half()
    return half if tensor.dtype == torch.float32 and bool(half.isfinite().all()) else tensor


def without_paths(value: Any) -> Any:
    """JSON data with null in place of every absolute path and of the options that name places."""
    if isinstance(value, dict):
        return {key: None if key in PATHS else without_paths(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_paths(item) for item in value]
    return None if isinstance(value, str) and os.path.isabs(value) else value


def describe(root: Path, folders: Sequence[str], commands: Sequence[str]) -> str:
    """The README beside shipped folders: the commands that made them, and the SHA-256 of every file."""
    lines = ["| file | bytes | SHA-256 |", "|---|---:|---|"]
    for file in sorted(file for folder in folders for file in (root / folder).iterdir()):
        content = file.read_bytes()
        name, digest = file.relative_to(root).as_posix(), hashlib.sha256(content).hexdigest()
        lines.append(f"| `{name}` | {len(content)} | `{digest}` |")
    made = "\n".join(commands)
    return f"""# The demo's trio

An agent (`gloves_flow_policy`), an expert flow (`gloves_expert_flow`) and a copilot (`gloves_copilot`) for Slalom with
state observations: the averaged weights in half precision, expert flow and copilot calibrated.
`gloves demo --train=true` makes them from nothing by

```bash
{made}
```

{chr(10).join(lines)}
"""


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m lerobot_gloves.demo.export CHECKPOINT FOLDER")
    try:
        export(Path(sys.argv[1]), Path(sys.argv[2]))
    except (ValueError, FileNotFoundError, FileExistsError) as error:
        sys.exit(f"export: {error}")
