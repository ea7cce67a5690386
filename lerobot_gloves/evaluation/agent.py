"""An agent loaded and wrapped by LeRobot's factory, ready to act in an environment."""

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import torch
from lerobot.envs import EnvConfig, make_env_pre_post_processors, preprocess_observation
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies import make_policy, make_policy_config, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.features import SAME_RATE, check_features, check_rate
from lerobot_gloves.perturbations import parse_perturbation, written_out

TASK_ATTRIBUTES = ("task_description", "task")
"""Where an environment tells its task string, in the order in which LeRobot asks."""


@dataclass(frozen=True)
class WrappedAgent:
    """A policy with what goes before it and behind it.

    Attributes:
        policy: Any policy; usually the wrapper around the agent.
        prepare: From observations under LeRobot's keys to the policy's input.
        finish: From the policy's actions (B, A) to the environment's.
        direct: Whether the two are the same, wherever they lie.
    """

    policy: PreTrainedPolicy
    prepare: Callable[[dict[str, Any]], dict[str, Any]]
    finish: Callable[[Tensor], Tensor]
    direct: bool = True

    @property
    def autocast(self) -> torch.autocast:
        """The precision that the policy asks for, as LeRobot's evaluation gives it."""
        config = self.policy.config
        return torch.autocast(torch.device(config.device).type, enabled=config.use_amp)

    def act(self, env: gym.vector.SyncVectorEnv, observation: dict[str, Any]) -> Tensor:
        """Its actions (B, A) on what B environments show."""
        batch = self.prepare({**preprocess_observation(observation), "task": task_strings(env)})
        with torch.inference_mode():
            return self.finish(self.policy.select_action(batch))


def load_agent(env: EnvConfig, agent: str, perturbation: str, seed: int, **corrected: Any) -> WrappedAgent:
    """A wrapped agent from LeRobot's factory.

    Args:
        env: The task.
        agent: Folder or Hub id of the policy.
        perturbation: `none`, or a specification, also of a compound.
        seed: Seed of the agent, the perturbation and the editor.
        **corrected: The wrapper's options for its adapter; without any the agent is not corrected.

    Raises:
        ValueError: If the agent is made for other observations or actions, or the adapter for another rate.
    """
    own = checkpoint_config("agent", agent)
    if adapter := corrected.get("adapter"):
        # The wrapper is not told the rate of an environment that is not ours.
        known = checkpoint_config("adapter", adapter, corrected.get("adapter_overrides", ()))
        check_rate(getattr(known, "fps", None), env.type, env.fps, SAME_RATE)
    config = make_policy_config(
        "gloves",
        agent=agent,
        # So that raw and adapted runs draw the same; an agent without a seed of its own has the global generators.
        agent_overrides=[f"--seed={seed}"] if hasattr(own, "seed") else [],
        perturbation=parse_perturbation(perturbation),
        seed=seed,
        **corrected,
    )
    with quiet():
        policy = make_policy(config, env_cfg=env).eval()
        before, behind = make_pre_post_processors(
            config,
            str(config.pretrained_path),
            preprocessor_overrides={"device_processor": {"device": str(config.device)}},
        )
    env_before, env_behind = make_env_pre_post_processors(env_cfg=env, policy_cfg=own)
    if not env_before.steps and not env_behind.steps:  # else nobody knows what the agent gets to see
        needed = {**(own.input_features or {}), **(own.output_features or {})}
        given = env_to_policy_features(env)
        check_features("the agent", needed, env.type, given, images=False)  # what it makes of them is its own affair
    return WrappedAgent(
        policy,
        lambda seen: before(env_before(seen)),
        lambda action: env_behind({ACTION: behind(action)})[ACTION],
        direct=not env_behind.steps,
    )


def resolve_perturbation(text: str) -> str:
    """A perturbation's specification with every option written out.

    Raises:
        ValueError: If it is not valid; the message lists what is.
    """
    return written_out(parse_perturbation(text))


def task_strings(env: gym.vector.SyncVectorEnv) -> list[str]:
    """The task string of each environment, from the attribute that LeRobot prefers."""
    for name in TASK_ATTRIBUTES:
        try:
            return list(env.call(name))
        except (AttributeError, NotImplementedError):
            continue
    return [""] * env.num_envs


@contextmanager
def quiet() -> Iterator[None]:
    """Keep to themselves what LeRobot prints and warns of at every loading."""
    level = logging.root.manager.disable
    logging.disable(max(level, logging.WARNING))
    try:
        with open(os.devnull, "w") as nothing, redirect_stdout(nothing):
            yield
    finally:
        logging.disable(level)
