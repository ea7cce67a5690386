"""What of a MetaWorld frame costs how much of a core, and how far the picture moves without it.

    OMP_NUM_THREADS=1 MUJOCO_GL=egl python scripts/benchmark_rendering.py

Frames are those of the expert's way through one episode. The difference is the mean of |a - b| over all pixels and
colours, of 255, beside the scene as it is: at full size, and with both reduced as `--dataset.image_size=96` does.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from lerobot.envs.metaworld import TASK_POLICY_MAPPING, MetaworldEnv
from PIL import Image

from lerobot_gloves.evaluation.rendering import FAST_SHADOWS
from lerobot_gloves.system.text import markdown_table

SIZE, SMALL = 480, 96


def without_multisampling(env: Any) -> None:
    """Edges are not smoothed."""
    env.model.vis.quality.offsamples = 0


def small_shadows(env: Any) -> None:
    """Shadows as in fast rendering."""
    env.model.vis.quality.shadowsize = FAST_SHADOWS


def without_shadow(env: Any) -> None:
    """No light casts one."""
    env.model.light_castshadow[:] = 0


WAYS: dict[str, Sequence[Callable[[Any], None]]] = {
    "as it is": (),
    "no multisampling": (without_multisampling,),
    f"a shadow map of {FAST_SHADOWS} x {FAST_SHADOWS}": (small_shadows,),
    "both: `--fast_rendering=true`": (without_multisampling, small_shadows),
    "no shadow at all": (without_shadow,),
    "no multisampling, no shadow": (without_multisampling, without_shadow),
}


def draw(task: str, changes: Sequence[Callable[[Any], None]], size: int, frames: int) -> tuple[float, list[np.ndarray]]:
    """Milliseconds of a core a frame, and the frames (size, size, 3) of the expert's way."""
    lerobots = MetaworldEnv(task, obs_type="pixels")
    lerobots._ensure_env()
    env: Any = lerobots._env
    env.mujoco_renderer.width = env.mujoco_renderer.height = size
    drawn, spent = [], 0.0
    for change in changes:
        change(env)
    env.seed(0)
    observation, _ = env.reset(seed=0)
    env.render()  # makes the context
    for _ in range(frames):
        began = time.process_time()
        drawn.append(np.array(env.render()))
        spent += time.process_time() - began
        observation, *_ = env.step(np.clip(lerobots.expert_policy.get_action(observation), -1, 1))
    env.close()
    return 1000 * spent / frames, drawn


def small(picture: np.ndarray) -> np.ndarray:
    """A frame, reduced."""
    return np.asarray(Image.fromarray(picture).resize((SMALL, SMALL), Image.Resampling.BOX))


def apart(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> float:
    """Mean absolute difference of frames."""
    return float(np.mean([np.abs(a.astype(float) - b).mean() for a, b in zip(one, other, strict=True)]))


def main() -> None:
    """Print a line for each way to draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="door-open-v3", choices=sorted(TASK_POLICY_MAPPING))
    parser.add_argument("--frames", type=int, default=20)
    arguments = parser.parse_args()
    lines, before = [["", "ms of a core", str(SIZE), str(SMALL)]], list[np.ndarray]()
    for name, changes in WAYS.items():
        cost, frames = draw(arguments.task, changes, SIZE, arguments.frames)
        before = before or frames
        reduced = apart([small(frame) for frame in before], [small(frame) for frame in frames])
        lines.append([name, f"{cost:.0f}", f"{apart(before, frames):.1f}", f"{reduced:.1f}"])
    cost, frames = draw(arguments.task, (), SMALL, arguments.frames)
    lines.append(
        [
            f"as it is, but {SMALL} x {SMALL} pixels",
            f"{cost:.0f}",
            "",
            f"{apart([small(frame) for frame in before], frames):.1f}",
        ]
    )
    print(f"MuJoCo {mujoco.__version__}, `{arguments.task}`\n\n{markdown_table(lines)}")


if __name__ == "__main__":
    main()
