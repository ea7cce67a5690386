"""An agent's proposals at the moments at which it was queried, staged as `lerobot_gloves.recording.sources` says."""

import gc
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION
from lerobot.utils.random_utils import set_seed
from torch import Tensor

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.evaluation.agent import load_agent, resolve_perturbation, task_strings
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.rollout import rollout
from lerobot_gloves.perturbations import Perturbation
from lerobot_gloves.recording import staging
from lerobot_gloves.recording.demonstrations import MODE
from lerobot_gloves.recording.observations import columns
from lerobot_gloves.recording.sources import SOURCES, agent_task
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.recording.workers import stage_all
from lerobot_gloves.specification import name_of


@dataclass(frozen=True)
class Agent:
    """Who is recorded.

    Attributes:
        checkpoint: Folder or Hub id of the policy.
        perturbation: What is done to its chunks: `none`, or a specification such as `noised:sigma=0.005`, of those that
            `SOURCES` has a label for.
        batch_size: Environments that run side by side.
    """

    checkpoint: str
    perturbation: str
    batch_size: int

    @property
    def source(self) -> str:
        """The label of its chunks, one of `lerobot_gloves.recording.sources.SOURCES`."""
        return name_of(self.perturbation)

    def settings(self) -> dict[str, Any]:
        """What its episodes depend on; the checkpoint counts by content, wherever it lies.

        Raises:
            ValueError: If there is no such checkpoint, or the perturbation is not valid, or has no label; the message
                lists what is.
        """
        perturbation = resolve_perturbation(self.perturbation)
        if self.source not in SOURCES[1:]:
            raise ValueError(
                f"perturbation {self.perturbation!r} cannot be recorded, as agents' datasets have no label for it: "
                f"choose from {', '.join(SOURCES[1:])}"
            )
        checkpoint_config("agent", self.checkpoint)
        content = checkpoint_hash(self.checkpoint)
        return {"agent": content, "perturbation": perturbation, "batch_size": self.batch_size}


class Listener(Perturbation):
    """Stands where the perturbation of a wrapped agent stands, and hears what comes out of it: every proposal, once.

    Attributes:
        proposal: The proposals (B, T, A) that came since `proposal` was set to None, raw and perturbed.
    """

    def __init__(self, perturbation: Perturbation | None):
        self._perturbation = perturbation
        self.proposal: Tensor | None = None

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        if self._perturbation is not None:
            self._perturbation.reset(batch_size, seed, first_episode)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        chunk = chunk if self._perturbation is None else self._perturbation(chunk, ran)
        self.proposal = chunk.clone()
        return chunk


def record(
    env_config: EnvConfig,
    agent: Agent,
    folder: Path,
    *,
    num_episodes: int,
    seed: int,
    num_workers: int,
    image_size: int | None = None,
    fast_rendering: bool = False,
) -> Iterator[int]:
    """Stage the episodes 0 to `num_episodes` - 1 that are not there yet, batch by batch.

    A batch is saved when its last episode has ended. It depends on the configuration, its size and the seed of its
    first episode alone, so it is the same whoever records it and whatever was recorded before.

    Args:
        env_config: The task.
        agent: Who is recorded.
        folder: The staging folder.
        num_episodes: How many episodes there shall be.
        seed: Environment seed of episode 0; episode i has seed + i.
        num_workers: Processes that record side by side.
        image_size: Height and width of the images that are kept, in pixels; None for those that the agent sees.
        fast_rendering: Whether MuJoCo draws without multisampling and with coarser shadows.

    Yields:
        How many episodes there are, whenever that has changed.
    """
    batches = [
        range(first, min(first + agent.batch_size, num_episodes)) for first in range(0, num_episodes, agent.batch_size)
    ]
    stage = partial(_stage, env_config, agent, folder, seed, image_size, fast_rendering)
    yield from stage_all(stage, folder, batches, num_workers)


def _stage(
    env_config: EnvConfig,
    agent: Agent,
    folder: Path,
    seed: int,
    image_size: int | None,
    fast_rendering: bool,
    batches: Sequence[range],
) -> Iterator[None]:
    torch.set_num_threads(1)  # the order of sums, and with it the last bits of an action, depend on it
    with environments(env_config, agent.batch_size, fast_rendering=fast_rendering) as env:
        for batch in batches:
            # The last batch is as large as the others; what is too many of it is dropped.
            episodes = play(env_config, agent, env, seed + batch.start, image_size)
            for index, episode in zip(batch, episodes, strict=False):
                staging.save(folder, index, episode)
            yield


def play(
    env_config: EnvConfig, agent: Agent, env: gym.vector.SyncVectorEnv, seed: int, image_size: int | None = None
) -> list[StagedEpisode]:
    """One episode in each of B environments, by an agent that was loaded for them.

    Args:
        env_config: The task.
        agent: Who plays.
        env: The environments.
        seed: Seed of the first environment, the others follow; also the seed of the agent and its perturbation.
        image_size: Height and width of the images that are kept, in pixels; None for those that the agent sees.

    Raises:
        ValueError: If the agent's proposals are not all of one length.
    """
    gc.collect()  # the last batch's agent refers to itself, and a GPU may not hold two
    set_seed(seed)  # for agents that draw from the global generators
    wrapped = load_agent(env_config, agent.checkpoint, agent.perturbation, seed)
    listener = Listener(wrapped.policy.perturbation)
    wrapped.policy.perturbation = listener
    queries: dict[int, list[dict[str, np.ndarray]]] = defaultdict(list)
    modes = getattr(env_config, "modes", None)  # the label of a task with an expert, whose dataset is merged with this

    def watch(observation: Mapping[str, Any], running: np.ndarray) -> None:
        proposal, listener.proposal = listener.proposal, None
        if proposal is None:
            return
        proposal = proposal[:, : getattr(wrapped.policy, "executed", None)]  # a dataset holds what an agent may do
        seen = {**columns(env_config, observation, image_size), ACTION: proposal.cpu().numpy()}
        if modes is not None:
            seen[MODE] = np.array([[modes.index(task)] for task in task_strings(env)], dtype=np.int64)
        for row in running.nonzero()[0]:
            queries[row].append({key: np.array(values[row]) for key, values in seen.items()})

    with wrapped.autocast:
        played = rollout(env, wrapped, range(seed, seed + env.num_envs), watch)
    episodes = []
    for row, outcome in enumerate(played):
        lengths = {len(query[ACTION]) for query in queries[row]}
        if len(lengths) != 1:
            raise ValueError(
                f"the proposals of {agent.checkpoint} have {' and '.join(map(str, sorted(lengths)))} actions: "
                "a dataset holds proposals of one length"
            )
        frames = {key: np.stack([query[key] for query in queries[row]]) for key in queries[row][0]}
        task = agent_task(agent.source, lengths.pop(), outcome.success)
        episodes.append(StagedEpisode(frames=frames, task=task, failure=outcome.failure))
    return episodes
