"""How fast tasks run on one core: control steps a second while the scripted expert plays, expert not counted.

For example `OMP_NUM_THREADS=1 python scripts/benchmark_tasks.py slalom keypad`. A control step with pictures draws a
frame of each camera.
"""

import argparse
import sys
import time
from dataclasses import replace
from typing import cast

import gymnasium as gym
import numpy as np
from lerobot.envs import EnvConfig

import lerobot_gloves.tasks
from lerobot_gloves.tasks.configuration import TaskConfig

IMAGE_SIZES = (96, 256)
SECONDS = 5.0
"""Of simulation for each row."""


def measure(config: TaskConfig) -> tuple[float, float, float, float]:
    """Seconds until the first observation, CPU seconds of a later reset; control steps a CPU second and a second."""
    begin = time.perf_counter()
    env = gym.make(config.gym_id, disable_env_checker=True, **config.demonstration_kwargs)
    env.reset(seed=0)
    start_up = time.perf_counter() - begin
    steps, episodes, wall, cpu, resetting = 0, 0, 0.0, 0.0, 0.0
    while wall < SECONDS:
        begin_cpu = time.process_time()
        observation, _ = env.reset(seed=episodes)
        resetting += time.process_time() - begin_cpu
        expert = config.make_expert(np.random.default_rng(episodes))
        expert.reset(env.get_wrapper_attr("task_description"))
        episodes += 1
        over = False
        while not over and wall < SECONDS:
            action = expert.act(observation)
            begin, begin_cpu = time.perf_counter(), time.process_time()
            observation, _, terminated, truncated, _ = env.step(action)
            cpu += time.process_time() - begin_cpu
            wall += time.perf_counter() - begin
            steps += 1
            over = terminated or truncated
    env.close()
    return start_up, resetting / episodes, steps / cpu, steps / wall


def main() -> None:
    """Print one row for each task and kind of observation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+", choices=lerobot_gloves.tasks.__all__)
    arguments = parser.parse_args()
    print(
        "| task | observations | first one, s | reset, CPU ms | control steps / CPU second | control steps / second |"
    )
    print("|---|---|---|---|---|---|")
    for name in arguments.tasks:
        config = cast(TaskConfig, EnvConfig.get_choice_class(f"gloves_{name}")())
        pictures = "pixels" if len(config.cameras) == 1 else f"pixels, {len(config.cameras)} cameras"
        rows = {"state": config}
        for size in IMAGE_SIZES:
            rows[f"{size} x {size} {pictures}"] = replace(config, obs_type="pixels_agent_pos", image_size=size)
        for observations, row in rows.items():
            try:
                start_up, reset, cpu, wall = measure(row)
            except RuntimeError as error:  # nothing here can draw them
                print(f"{name}, {observations}: {error}", file=sys.stderr)
                continue
            print(f"| {name} | {observations} | {start_up:.2f} | {1000 * reset:.1f} | {cpu:.0f} | {wall:.0f} |")


if __name__ == "__main__":
    main()
