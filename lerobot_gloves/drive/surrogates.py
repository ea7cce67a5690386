"""Scripted drivers on the page's way to the robot, without the page: many episodes at once, as fast as they go."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.envs import preprocess_observation
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_gloves.drive.driver import Driver, Skill
from lerobot_gloves.drive.stick import still
from lerobot_gloves.drive.view import View
from lerobot_gloves.evaluation.agent import WrappedAgent, task_strings
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.tasks.configuration import OBS_COMMAND


@dataclass(frozen=True)
class Drive:
    """An episode that a scripted driver drove.

    Attributes:
        seed: Seed of its environment.
        success: Whether it succeeded.
        failure: Why it did not, in the environment's words; "" for a success.
        steps: Control steps that it took.
        reaction: The driver's reaction time, in seconds.
        commands: At how many steps the robot was commanded to move.
        changed: Of these, how many were executed otherwise than commanded.
        moved: Mean distance of executed from commanded actions, in lengths of the commanded ones.
        crept: Steps at which the robot was to stand still and anything but that was executed.
    """

    seed: int
    success: bool
    failure: str
    steps: int
    reaction: float
    commands: int
    changed: int
    moved: float
    crept: int


class Surrogates:
    """Stands where `rollout` has an agent: drivers, and the wrapper around what they command.

    Args:
        person: The wrapper around `gloves_person`.
        task: The `--env.type`.
        view: The task's.
        skill: How well they drive.
        seeds: Those of the environments.
    """

    def __init__(self, person: WrappedAgent, task: str, view: View, skill: Skill, seeds: Sequence[int]) -> None:
        self._person, self._task, self._view, self._skill, self._seeds = person, task, view, skill, seeds
        self.policy: PreTrainedPolicy = person.policy
        self.direct = person.direct
        self.drivers: list[Driver] = []
        self.commands, self.changed, self.crept = (np.zeros(len(seeds), dtype=int) for _ in range(3))
        self.moved = np.zeros(len(seeds))

    def act(self, env: gym.vector.SyncVectorEnv, observation: dict[str, Any]) -> Tensor:
        """What is executed of the drivers' commands, (B, A)."""
        tasks = task_strings(env)
        if not self.drivers:
            self.drivers = [
                Driver(self._task, self._view, self._skill, seed, asked)
                for seed, asked in zip(self._seeds, tasks, strict=True)
            ]
        shown = [{key: value[row] for key, value in observation.items()} for row in range(len(self._seeds))]
        sent = [driver.command(seen) for driver, seen in zip(self.drivers, shown, strict=True)]
        commands = np.stack([self._view.steer(*one) for one in sent])
        batch = self._person.prepare({**preprocess_observation(observation), "task": tasks})
        running = self.policy.running.numpy().copy()
        with torch.inference_mode():
            action = self._person.finish(self.policy.select_action({**batch, OBS_COMMAND: torch.from_numpy(commands)}))
        action = action.cpu().clone()
        rests = np.array([still(one) for one in sent])
        action[torch.from_numpy(rests)] = torch.from_numpy(commands[rests])
        away = np.linalg.norm(action.numpy() - commands, axis=1)
        self.crept += running & rests & (away > 0)
        moves = running & ~rests
        self.commands += moves
        self.changed += moves & (away > 0)
        self.moved[moves] += away[moves] / np.linalg.norm(commands[moves], axis=1)
        return action


def play(
    env: gym.vector.SyncVectorEnv, person: WrappedAgent, task: str, view: View, skill: Skill, seeds: Sequence[int]
) -> list[Drive]:
    """Let drivers of one skill drive an episode in each environment.

    Args:
        env: B environments.
        person: The wrapper around `gloves_person`.
        task: The `--env.type`.
        view: The task's.
        skill: The drivers'.
        seeds: B seeds of the environments.
    """
    agent = Surrogates(person, task, view, skill, seeds)
    return [
        Drive(
            one.seed,
            one.success,
            one.failure,
            one.steps,
            round(driver.reaction, 4),
            int(agent.commands[row]),
            int(agent.changed[row]),
            round(float(agent.moved[row] / max(1, agent.commands[row])), 4),
            int(agent.crept[row]),
        )
        for row, (one, driver) in enumerate(zip(rollout(env, agent, seeds), agent.drivers, strict=True))  # type: ignore[arg-type]
    ]
