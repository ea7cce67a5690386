"""Runs as `lerobot-eval` leaves them, played by the scripted expert instead of a policy."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_gloves.demo.evaluation import CHUNK_LOG, Comparison, PlayedRun, Run
from lerobot_gloves.tasks.slalom.environment import Slalom
from lerobot_gloves.tasks.slalom.expert import SlalomExpert

RAW, CORRECTED = Run("raw", "raw agent", recorded=True), Run("feeg_gate", "FEEG + gate", recorded=True)


def comparison(folder: Path, episodes: int = 2) -> Comparison:
    return Comparison(Path("agent"), "noised:sigma=0.005", episodes, 10000, folder)


def played(run: Run, seeds: list[int], *, straight: bool = False) -> PlayedRun:
    """The expert's episodes, or those of somebody who goes straight ahead into the first pillar."""
    successes, actions, observed = [], [], []
    for seed in seeds:
        env = Slalom(image_size=1)
        observation, info = env.reset(seed=seed)
        expert = SlalomExpert(np.random.default_rng(seed))
        expert.reset(env.task)
        done, steps, states = False, [], []
        while not done:
            action = np.array([-0.0006, 0.006]) if straight else expert.act(observation)
            steps.append(np.asarray(action, np.float32))
            states.append(observation["agent_pos"])
            observation, _, terminated, truncated, info = env.step(steps[-1])
            done = terminated or truncated
        successes.append(info["is_success"])
        actions.append(np.array(steps))
        observed.append(np.array(states))
    return PlayedRun(run, successes, actions, observed)


def leave(result: PlayedRun, folder: Path) -> None:
    """Write a run's files."""
    metrics = {"successes": result.successes}
    (folder / "recordings").mkdir(parents=True)
    (folder / "eval_info.json").write_text(json.dumps({"per_task": [{"task_id": 0, "metrics": metrics}]}))
    for number, (actions, states) in enumerate(zip(result.actions, result.set_points_and_tips, strict=True)):
        part = f"env_{number}" if len(result.actions) > 1 else ""
        file = folder / "recordings" / "gloves_slalom_0" / part / "data" / "chunk-000" / "file-000.parquet"
        file.parent.mkdir(parents=True)
        pq.write_table(pa.table({"action": actions.tolist(), "agent_pos": states.tolist()}), file)
    if result.chunks:
        (folder / CHUNK_LOG).write_text("".join(json.dumps(chunk) + "\n" for chunk in result.chunks))
