"""How often each task's scripted expert succeeds, at ease and jostled as in a recording, and in how many control steps.

OMP_NUM_THREADS=1 python scripts/benchmark_experts.py keypad can
"""

import argparse
from collections import Counter

import gymnasium as gym
import numpy as np
from lerobot.envs import EnvConfig

import lerobot_gloves.tasks

SEED = 50000


def play(config: EnvConfig, env: gym.Env, seed: int, *, jostled: bool) -> tuple[bool, str, int]:
    """One episode: whether it succeeded, why not, and its length."""
    expert = config.make_expert(np.random.default_rng(seed))
    observation, _ = env.reset(seed=seed)
    expert.reset(env.get_wrapper_attr("task_description"))
    over, steps, info = False, 0, {}
    while not over:
        action = expert.act(observation)
        observation, _, terminated, truncated, info = env.step(expert.disturb(action) if jostled else action)
        over, steps = terminated or truncated, steps + 1
    return bool(info["is_success"]), info["failure"], steps


def main() -> None:
    """Print one row for each task, kind of episode and condition."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+", choices=lerobot_gloves.tasks.__all__)
    parser.add_argument("--episodes", type=int, default=200, help="of each row; by default 200")
    arguments = parser.parse_args()
    print(f"seeds {SEED} to {SEED + arguments.episodes - 1}\n")
    print("| expert of | episodes | jostled | success | failed | mean steps |")
    print("|---|---|---|---|---|---|")
    for task in arguments.tasks:
        config = EnvConfig.get_choice_class(f"gloves_{task}")()
        kinds = {"the task's": config.gym_kwargs}
        if config.demonstration_kwargs.get("episode") != config.gym_kwargs.get("episode"):
            kinds["as recorded"] = config.demonstration_kwargs
        for kind, options in kinds.items():
            env = gym.make(config.gym_id, disable_env_checker=True, **options)
            for jostled in (False, True):
                seeds = range(SEED, SEED + arguments.episodes)
                played = [play(config, env, seed, jostled=jostled) for seed in seeds]
                failures = Counter(failure for success, failure, _ in played if not success)
                successes, steps = sum(success for success, _, _ in played), np.mean([n for _, _, n in played])
                failed = ", ".join(f"{name} {count}" for name, count in failures.items()) or "–"
                row = (task, kind, "yes" if jostled else "no", f"{successes} of {len(played)}", failed, f"{steps:.1f}")
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
