"""The wrapper around a person: what becomes of a command under the assistance, and the fault, of the moment."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.envs import EnvConfig, preprocess_observation
from lerobot.envs.utils import env_to_policy_features
from torch import Tensor

from lerobot_gloves.drive.protocol import Assist, Settings
from lerobot_gloves.evaluation.agent import WrappedAgent, load_agent, task_strings
from lerobot_gloves.evaluation.person import saved_person
from lerobot_gloves.perturbations import Perturbation, parse_perturbation
from lerobot_gloves.tasks.configuration import OBS_COMMAND

UNLIMITED = 2.0
"""A limit that turns any action into any other: that of a robot whose actions are as large to either side."""

UNASKED = 0.05
"""The level of a gate that there is not, for the page to show."""


@dataclass(frozen=True)
class Acted:
    """What became of a command.

    Attributes:
        action: What is to be executed, raw, (A,), float32.
        edited: Whether the proposal was edited.
        known: What else is known of it, see `Correction.known`.
    """

    action: np.ndarray
    edited: bool = False
    known: Mapping[str, float] = field(default_factory=dict)

    @property
    def p_value(self) -> float | None:
        """Its conformal p-value, None without a calibrated score."""
        return self.known.get("p_value")


class Fault(Perturbation):
    """Stands where the wrapper has its perturbation, so that it may be another one from one step to the next.

    Attributes:
        name: What it is called, `none` for none.
        proposal: What it made of the last chunk, raw, (B, T, A).
    """

    def __init__(self) -> None:
        self.name = "none"
        self._fault: Perturbation | None = None
        self._begun: tuple[int, int, int] | None = None
        self.proposal: Tensor | None = None

    def choose(self, name: str, fault: Perturbation | None) -> None:
        """From now on this one; what it does begins anew."""
        self.name, self._fault = name, fault
        if fault is not None and self._begun is not None:
            fault.reset(*self._begun)

    def reset(self, batch_size: int, seed: int, first_episode: int = 0) -> None:
        self._begun = (batch_size, seed, first_episode)
        if self._fault is not None:
            self._fault.reset(*self._begun)

    def __call__(self, chunk: Tensor, ran: int | None = None) -> Tensor:
        self.proposal = chunk if self._fault is None else self._fault(chunk, ran)
        return self.proposal.clone()


class Assistance:
    """A person, wrapped.

    Attributes:
        adapter: Folder or Hub id of what corrects; None if nothing does.
        ungated: Why there is no gate; "" if there is one.
        settings: Those of the moment.

    Args:
        agent: The wrapper around `gloves_person`.
        options: The wrapper's options for its adapter.
        faults: Specifications of perturbations, by the names under which they are chosen.
    """

    def __init__(self, agent: WrappedAgent, options: Mapping[str, Any], faults: Mapping[str, str]):
        self._agent, self._options, self._faults = agent, dict(options), dict(faults)
        self._policy: Any = agent.policy
        self._fault = self._policy.perturbation = Fault()
        self.adapter: str | None = options.get("adapter")
        self.ungated = "there is no adapter" if self.adapter is None else ""
        alpha = UNASKED
        if self.adapter is not None:
            try:
                alpha = self._policy.adjust(gate=True).alpha
            except ValueError as error:
                self.ungated = str(error)
        ungated = self.ungated or options.get("gate") is False
        assistance: Assist = "off" if self.adapter is None else "always" if ungated else "gate"
        self.choose(Settings(assistance, alpha, UNLIMITED, "none"))

    def choose(self, settings: Settings) -> None:
        """Help in another way from the next command on.

        Without assistance the gate still says what it thinks of a command, if it can.

        Raises:
            ValueError: If there is no such fault, no gate, no adapter, or the gate can have no such alpha; then nothing
                has changed.
        """
        how = settings.assistance
        if settings.fault != "none" and settings.fault not in self._faults:
            raise ValueError(f"there is no fault {settings.fault!r}: choose from none, {', '.join(self._faults)}")
        if self.adapter is None and how != "off":
            raise ValueError("there is no adapter, so nothing can assist: name one by --policy.adapter")
        if how == "gate" and self.ungated:
            raise ValueError(self.ungated)
        if self.adapter is not None:
            gate = how != "always" and not self.ungated
            method = "none" if how == "off" else self._options.get("method")
            self._policy.adjust(method=method, gate=gate, alpha=settings.alpha)
        if settings.fault != self._fault.name:
            self._fault.choose(settings.fault, parse_perturbation(self._faults.get(settings.fault, "none")))
        self.settings = settings

    def reset(self) -> None:
        """A new episode begins."""
        self._policy.reset()

    def act(self, env: gym.vector.SyncVectorEnv, observation: dict[str, Any], command: np.ndarray) -> Acted:
        """What is executed of a command.

        Args:
            env: One environment.
            observation: What it shows.
            command: The action (A,) that the person asks for, raw, float32.

        Raises:
            ValueError: If the observation is not one that the adapter can read, or the editor returns NaN.
        """
        seen = {**preprocess_observation(observation), "task": task_strings(env)}
        batch = self._agent.prepare({**seen, OBS_COMMAND: torch.from_numpy(command)[None]})
        self._policy.running = torch.ones(1, dtype=torch.bool)
        with torch.inference_mode(), self._agent.autocast:
            action = self._agent.finish(self._policy.select_action(batch))[0].cpu()
        correction, proposal = self._policy.correction, self._fault.proposal
        known = {} if correction is None else correction.known
        if correction is None or not bool(correction.edited[0]):
            return Acted(action.numpy(), known=known)
        assert proposal is not None
        if self.settings.limit < UNLIMITED:
            largest = self.settings.limit * torch.from_numpy(env.single_action_space.high)  # type: ignore[attr-defined]
            proposed = proposal[0, 0].cpu()
            action = proposed + (action - proposed).clamp(-largest, largest)
        return Acted(action.numpy(), edited=True, known=known)


def load_assistance(
    env: EnvConfig, options: Mapping[str, Any], faults: Mapping[str, str], device: str | None = None
) -> Assistance:
    """A person in a task, with what corrects them as the page says.

    Args:
        env: The task.
        options: See `load_person`.
        faults: Specifications of perturbations by their names.
        device: See `load_person`.

    Raises:
        ValueError: See `load_person`.
    """
    return Assistance(load_person(env, options, device), options, faults)


def load_person(env: EnvConfig, options: Mapping[str, Any], device: str | None = None) -> WrappedAgent:
    """The wrapper around `gloves_person` in a task.

    Args:
        env: The task.
        options: The wrapper's options for its adapter; without `adapter` nothing corrects.
        device: Where the adapter computes; None for LeRobot's choice.

    Raises:
        ValueError: If the adapter does not fit the task, or lacks what the options ask for.
    """
    with saved_person(env_to_policy_features(env), options, device) as person:
        return load_agent(env, person, "none", 0, **options)
