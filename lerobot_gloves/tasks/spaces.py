"""What a task's environment promises to return."""

from collections.abc import Collection

import gymnasium as gym
import numpy as np


def observation_space(
    *,
    state: int,
    goal: int,
    scene: int | None,
    cameras: Collection[str],
    image_size: int,
    goal_range: tuple[float, float] = (0.0, 1.0),
) -> gym.spaces.Dict:
    """The space of a task's observations.

    Args:
        state: Length of `agent_pos`.
        goal: Length of `goal`.
        scene: Length of `environment_state`; None if there is none.
        cameras: Names of the frames in `pixels`; without any there are no `pixels`.
        image_size: Height and width of a frame, in pixels.
        goal_range: Between what the goal's entries lie.
    """
    spaces: dict[str, gym.Space] = {
        "agent_pos": gym.spaces.Box(-np.inf, np.inf, (state,), np.float32),
        "goal": gym.spaces.Box(*goal_range, (goal,), np.float32),
    }
    if scene is not None:
        spaces["environment_state"] = gym.spaces.Box(-np.inf, np.inf, (scene,), np.float32)
    if cameras:
        frame = gym.spaces.Box(0, 255, (image_size, image_size, 3), np.uint8)
        spaces["pixels"] = gym.spaces.Dict(dict.fromkeys(cameras, frame))
    return gym.spaces.Dict(spaces)
