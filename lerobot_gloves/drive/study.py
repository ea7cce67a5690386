"""A study that a person runs on themselves: the same episodes with and without assistance, in random order, blind."""

from collections.abc import Callable
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np
from lerobot.utils.constants import ACTION

from lerobot_gloves.drive.assistance import Assistance
from lerobot_gloves.drive.protocol import Begin, Settings
from lerobot_gloves.drive.session import Session, Snapshot, Step, drained
from lerobot_gloves.drive.study_folder import ASSISTED, COMMANDED, EDITED, StudyFolder
from lerobot_gloves.recording.staging import StagedEpisode


class Finishing(Protocol):
    """What is made of a study that is over."""

    def results(self, episodes: list[StagedEpisode]) -> dict[str, Any]:
        """What the pages are told, of all episodes in the order of the trials."""
        ...

    def dataset(self) -> None:
        """Make the dataset, which takes some seconds."""
        ...


class Study:
    """Plays the trials that are left, and blinds what the pages are told.

    A page sees neither gate nor edits nor what is executed, and cannot change how the person is helped. An episode that
    has begun is driven to its end; then the person asks for the next one.

    Attributes:
        stick: What the person commands.

    Args:
        session: What is driven.
        assistance: The session's.
        folder: The study on the disk.
        columns: From an observation of one environment to a dataset's features (1, ...).
        finishing: What is made of it when all is driven.
    """

    def __init__(
        self,
        session: Session,
        assistance: Assistance,
        folder: StudyFolder,
        columns: Callable[[dict[str, Any]], dict[str, np.ndarray]],
        finishing: Finishing,
    ) -> None:
        self.stick = session.stick
        self._session, self._assistance, self._folder = session, assistance, folder
        self._columns, self._finishing = columns, finishing
        self._helped = assistance.settings
        self._asked: SimpleQueue[Settings | Begin] = SimpleQueue()
        self._frames: list[dict[str, np.ndarray]] = []
        self._notice, self._over, self._assembled = "", False, False
        self._told: tuple[Any, int] | None = None
        self._results: dict[str, Any] | None = None
        self._index = folder.done
        session.watchers.append(self._watch)
        self._begin()

    def ask(self, message: Settings | Begin) -> None:
        """The next episode, once this one is over; all else is refused."""
        self._asked.put(message)

    def tick(self) -> Snapshot:
        """Take a step, if an episode is on."""
        if self._results is not None:
            self.stick.release()  # there is nothing left to drive
            if not self._assembled:
                self._finishing.dataset()  # a tick late, so that the pages have the results before
                self._assembled = True
        self._obey()
        return self._blinded(self._session.tick())

    def draw(self) -> bytes:
        """The camera's frame, a JPEG."""
        return self._session.draw()

    def _obey(self) -> None:
        for message in drained(self._asked):
            if isinstance(message, Settings):
                self._notice = "in a study nothing can be set"
            elif message.episode == "again" or not self._over:
                self._notice = "in a study every episode is driven once, to its end"
            elif self._index < len(self._folder.trials):
                self._begin()

    def _begin(self) -> None:
        self._frames, self._over, self._notice = [], False, ""
        if self._index == len(self._folder.trials):
            self._over = True
            self._results = self._finishing.results(self._folder.load())
            return
        trial = self._folder.trials[self._index]
        self._assistance.choose(self._helped if trial.assisted else replace(self._helped, assistance="off"))
        self._session.begin(trial.seed)

    def _watch(self, step: Step) -> None:
        if self._over:
            return
        trial = self._folder.trials[self._index]
        seen = {key: values[0].copy() for key, values in self._columns(step.observation).items()}
        told = {ASSISTED: trial.assisted, EDITED: step.acted.edited}
        facts = {key: np.array([value], dtype=np.float32) for key, value in told.items()}
        self._frames.append({**seen, ACTION: step.acted.action, COMMANDED: step.command, **facts})
        if step.over:
            frames = {key: np.stack([frame[key] for frame in self._frames]) for key in self._frames[0]}
            self._folder.save(self._index, StagedEpisode(frames, self._session.task, failure=step.failure))
            self._index, self._over = self._index + 1, True
            if self._index == len(self._folder.trials):
                self._results = self._finishing.results(self._folder.load())

    def _blinded(self, snapshot: Snapshot) -> Snapshot:
        known = (snapshot.about, self._index if self._over else -1)
        if self._told is None or self._told[0] is not known[0] or self._told[1] != known[1]:
            number = self._index + (not self._over)
            study = {"episode": number, "of": len(self._folder.trials), "results": self._results}
            self._about, self._told = {**snapshot.about, "settings": None, "study": study}, known
        secret = {"executed": (0.0, 0.0, 0.0), "edited": False, "p": None}
        notice = snapshot.state["notice"] or self._notice
        trail = tuple((right, down, False) for right, down, _ in snapshot.trail)
        return Snapshot(self._about, {**snapshot.state, **secret, "notice": notice}, trail, snapshot.picture)
