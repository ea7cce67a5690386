"""How fast Slalom runs on one core: control steps a second, on state observations and on pictures.

OMP_NUM_THREADS=1 python scripts/benchmark_slalom.py
"""

import time

import gymnasium as gym
import numpy as np

import lerobot_gloves.tasks  # noqa: F401

SETTINGS = {
    "state": {"obs_type": "state"},
    "96 x 96 pixels": {"obs_type": "pixels_agent_pos", "image_size": 96},
    "256 x 256 pixels": {"obs_type": "pixels_agent_pos", "image_size": 256},
}
SECONDS = 5.0


def measure(options: dict) -> tuple[float, float, float]:
    """Seconds until the first observation, and control steps a CPU second and a second of the clock."""
    begin = time.perf_counter()
    env = gym.make("gloves/Slalom-v0", disable_env_checker=True, **options)
    env.reset(seed=0)
    start_up = time.perf_counter() - begin
    actions = np.random.default_rng(0).uniform(-0.01, 0.01, (10_000, 2))
    steps, begin, cpu = 0, time.perf_counter(), time.process_time()
    while time.perf_counter() - begin < SECONDS:
        _, _, terminated, truncated, _ = env.step(actions[steps % len(actions)])
        steps += 1
        if terminated or truncated:
            env.reset(seed=steps)
    return start_up, steps / (time.process_time() - cpu), steps / (time.perf_counter() - begin)


def main() -> None:
    """Print one row for each kind of observation."""
    print("| observations | first observation, s | control steps / CPU second | control steps / second |")
    print("|---|---|---|---|")
    for name, options in SETTINGS.items():
        start_up, cpu, wall = measure(options)
        print(f"| {name} | {start_up:.2f} | {cpu:.0f} | {wall:.0f} |")


if __name__ == "__main__":
    main()
