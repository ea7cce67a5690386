"""Recorded episodes once more: the simulator repeats them exactly, so that they can be drawn from any side."""

from dataclasses import dataclass

import numpy as np

from lerobot_gloves.demo.evaluation import PlayedRun
from lerobot_gloves.tasks.slalom.environment import Slalom


@dataclass(frozen=True)
class Path2d:
    """Where a rod's tip went in one episode.

    Attributes:
        tips: (L + 1, 2) metres, from the start to the episode's end.
        failure: "" for a success, else the environment's word for what went wrong.
        frames: (L + 1, S, S, 3) uint8 RGB, if asked for.
    """

    tips: np.ndarray
    failure: str
    frames: np.ndarray | None = None


def replay(played: PlayedRun, episode: int, seed: int, *, image_size: int | None = None) -> Path2d:
    """Play an episode's recorded actions in a fresh environment.

    Args:
        played: A run.
        episode: Number of the episode.
        seed: Seed of its environment.
        image_size: Height and width of frames, in pixels; None draws none.

    Raises:
        RuntimeError: If it does not go exactly as recorded.
    """
    env = Slalom(image_size=image_size or 1)
    observation, info = env.reset(seed=seed)
    observed, frames = [observation["agent_pos"]], []
    for action in played.actions[episode]:
        frames += [] if image_size is None else [env.render()]
        observation, _, _, _, info = env.step(action)
        observed.append(observation["agent_pos"])
    frames += [] if image_size is None else [env.render()]
    same = np.array_equal(np.array(observed[:-1]), played.set_points_and_tips[episode])
    if not same or info["is_success"] != played.successes[episode]:
        raise RuntimeError(f"{played.run.label}, seed {seed}: the simulator did not repeat the recorded episode")
    return Path2d(np.array(observed)[:, 2:], info["failure"], np.array(frames) if frames else None)
