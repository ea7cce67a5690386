"""Episodes that a person drives, one step at a time."""

import io
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from queue import Empty, SimpleQueue
from typing import Any, Literal, Protocol

import gymnasium as gym
import numpy as np
from lerobot.envs.utils import NEW_ROLLOUT_OPTION
from PIL import Image

from lerobot_gloves.drive.assistance import Acted, Assistance
from lerobot_gloves.drive.protocol import Begin, Settings
from lerobot_gloves.drive.stick import CENTRE, Position, Stick, still
from lerobot_gloves.drive.view import View
from lerobot_gloves.evaluation.agent import task_strings
from lerobot_gloves.evaluation.rollout import fact
from lerobot_gloves.system.errors import one_line

type Phase = Literal["ready", "driving", "success", "failure"]


@dataclass(frozen=True)
class Snapshot:
    """All that a page needs to know at a step.

    Attributes:
        about: What is asked for and how the person is helped; the same object until one of them changes.
        state: What happened at this step; the same object for one without the step's frame and one with it.
        trail: The way so far, (right, down, whether edited) each.
        picture: The camera's last frame, a JPEG; the same object until there is another one. Empty before the first.
    """

    about: dict[str, Any]
    state: dict[str, Any]
    trail: tuple[tuple[float, float, bool], ...]
    picture: bytes


@dataclass(frozen=True)
class Step:
    """What happened at a step of an episode.

    Attributes:
        observation: What one environment showed before it, as a vector environment does.
        command: The action that the person asked for, raw, (A,), float32.
        acted: What became of it.
        over: Whether the episode ended with it.
        failure: Why it failed, in the environment's word; "" if it did not.
    """

    observation: dict[str, Any]
    command: np.ndarray
    acted: Acted
    over: bool
    failure: str


class Driven(Protocol):
    """What the server and the loop need of a session."""

    stick: Stick

    def ask(self, message: Settings | Begin) -> None: ...

    def tick(self) -> Snapshot: ...

    def draw(self) -> bytes: ...


def drained[T](queue: SimpleQueue[T]) -> Iterator[T]:
    """What a queue holds, taken out."""
    while True:
        try:
            yield queue.get_nowait()
        except Empty:
            return


class Session:
    """Whoever steps it calls `tick` at the task's rate, from one thread; `stick` and `ask` are for any thread.

    An episode begins at the first command that moves the robot; from then on every tick is a step of it, whether
    anybody commands or not. Who moves nothing stands still, whatever assistance or fault would make of it.

    Attributes:
        stick: What the person commands.
        watchers: Called with every step of an episode, by `tick`.

    Args:
        env: One environment.
        view: How its task is seen and steered.
        assistance: The person's.
        seed: Seed of the first episode, and of the choice of the others.
        clock: Seconds that only grow.
    """

    def __init__(
        self,
        env: gym.vector.SyncVectorEnv,
        view: View,
        assistance: Assistance,
        seed: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock, self.stick = clock, Stick(clock)
        self.watchers: list[Callable[[Step], None]] = []
        self._env, self._view, self._assistance = env, view, assistance
        self._rng, self._first, self._seed = np.random.default_rng(seed), seed, seed
        self._asked: SimpleQueue[Settings | Begin] = SimpleQueue()
        self._phase: Phase = "ready"
        self._episode = self._steps = 0
        self._ending = self._notice = ""
        self._trail: list[tuple[float, float, bool]] = []
        self._picture, self._drawn = b"", (-1, -1)
        self._begin()

    def ask(self, message: Settings | Begin) -> None:
        """Other settings, or another episode, from the next tick on."""
        self._asked.put(message)

    @property
    def task(self) -> str:
        """What is asked for, as the environment says it."""
        return task_strings(self._env)[0]

    def begin(self, seed: int) -> None:
        """Begin the episode of a seed; from the thread that calls `tick`."""
        self._seed = seed
        self._begin()

    def tick(self) -> Snapshot:
        """Take a step, if an episode is on."""
        began = self._clock()
        self._obey()
        sent = self.stick.position
        if self._phase == "ready" and not still(sent):
            self._phase = "driving"
        acted = self._step(sent) if self._phase == "driving" else Acted(self._view.steer(*CENTRE))
        state = {
            "type": "state",
            "episode": self._episode,
            "step": self._steps,
            "time": began,
            "phase": self._phase,
            "ending": self._ending,
            "place": self._trail[-1][:2],
            **self._view.moment(self._shown()),
            "sent": sent,
            "executed": self._view.arrow(acted.action),
            "edited": acted.edited,
            "p": acted.p_value,
            "notice": self._notice,
        }
        return Snapshot(self._about, state, tuple(self._trail), self._picture)

    def draw(self) -> bytes:
        """The camera's frame, a JPEG; the same object while it would be the same picture."""
        now = (self._episode, self._steps)
        if self._drawn != now:
            file = io.BytesIO()
            Image.fromarray(self._env.call("render")[0]).save(file, "JPEG", quality=80)
            self._picture, self._drawn = file.getvalue(), now
        return self._picture

    def _obey(self) -> None:
        for message in drained(self._asked):
            if isinstance(message, Begin):
                if message.episode == "next":
                    self._seed = self._first + int(self._rng.integers(1_000_000))
                self._begin()
                continue
            try:
                self._assistance.choose(message)
                self._notice = ""
            except ValueError as error:
                self._notice = one_line(error)
            self._tell()

    def _begin(self) -> None:
        self._assistance.reset()
        self._observation, _ = self._env.reset(seed=[self._seed], options={NEW_ROLLOUT_OPTION: True})
        self._phase, self._ending, self._steps, self._notice = "ready", "", 0, ""
        self._episode += 1
        self._trail = [(*self._place(), False)]
        self._tell()

    def _tell(self) -> None:
        task = self.task
        self._about: dict[str, Any] = {
            "type": "about",
            "episode": self._episode,
            "task": task,
            "words": self._view.words(task),
            "targets": self._view.targets(task),
            "settings": asdict(self._assistance.settings),
        }

    def _step(self, sent: Position) -> Acted:
        # Asked even where nobody commands: histories and faults go on in time.
        command, seen, failure = self._view.steer(*sent), self._observation, ""
        try:
            acted = self._assistance.act(self._env, seen, command)
        except ValueError as error:
            acted, self._notice = Acted(self._view.steer(*CENTRE)), one_line(error)
        if still(sent):
            acted = Acted(command)
        self._observation, _, terminated, truncated, info = self._env.step(acted.action[None])
        self._steps += 1
        self._trail.append((*self._place(), acted.edited))
        if fact(info, "is_success", 0, False):
            self._phase = "success"
        elif terminated[0] or truncated[0]:
            failure = str(fact(info, "failure", 0, "")) or "timeout"
            self._phase, self._ending = "failure", self._view.ending(failure)
        step = Step(seen, command, acted, self._phase != "driving", failure)
        for watch in self.watchers:
            watch(step)
        return acted

    def _place(self) -> tuple[float, float]:
        return self._view.place(self._shown())

    def _shown(self) -> dict[str, Any]:
        return {key: value[0] for key, value in self._observation.items() if key != "pixels"}
