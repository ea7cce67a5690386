"""A study begun or taken up, from what was typed."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lerobot.envs import EnvConfig

from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.drive.assistance import Assistance
from lerobot_gloves.drive.session import Session
from lerobot_gloves.drive.study import Study
from lerobot_gloves.drive.study_folder import StudyFolder
from lerobot_gloves.drive.study_results import driven, paths_figure, study_table
from lerobot_gloves.drive.view import View
from lerobot_gloves.recording.dataset import assemble
from lerobot_gloves.recording.observations import columns
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.report.html_page import svg
from lerobot_gloves.report.markdown import markdown
from lerobot_gloves.system.files import write_text


@dataclass(frozen=True)
class Finish:
    """Writes what comes of a study into its folder: `results.md`, `paths.svg`, `dataset/`.

    Attributes:
        env: The task.
        view: How it is seen.
        folder: The study on the disk.
        helped: How the person was helped, for the dataset's card.
        command: What was typed, for the same.
    """

    env: EnvConfig
    view: View
    folder: StudyFolder
    helped: str
    command: str

    def results(self, episodes: list[StagedEpisode]) -> dict[str, Any]:
        """The table's cells and the picture, for the page."""
        found = [
            driven(trial.seed, episode, self._place, self.view.arrow)
            for trial, episode in zip(self.folder.trials, episodes, strict=True)
        ]
        table = study_table(found, self.env.fps)
        picture = svg(paths_figure(found, self.view), "The ways of all episodes", page=False)
        write_text(self.folder.root / "results.md", f"{markdown(table)}\n\n![The ways of all episodes](paths.svg)\n")
        write_text(self.folder.root / "paths.svg", picture)
        return {
            "caption": table.caption,
            "header": table.header,
            "lines": [[entry.in_one_line for entry in line] for line in table.lines],
            "picture": f"data:image/svg+xml;base64,{base64.b64encode(picture.encode()).decode()}",
            "folder": str(self.folder.root),
        }

    def dataset(self) -> None:
        """The dataset, unless it is there."""
        root = self.folder.root / "dataset"
        if root.exists():
            return
        trials = self.folder.trials
        seeds = sorted({trial.seed for trial in trials})
        person = (
            f"Task: `{self.env.type}`. Seeds {seeds[0]} to {seeds[-1]}, each driven twice. Assistance: {self.helped}.\n"
            f"Episodes with it: {', '.join(str(i) for i, trial in enumerate(trials) if trial.assisted)}."
        )
        name = f"local/{self.env.type.removeprefix('gloves_')}_study"
        how: dict[str, Any] = {"repo_id": name, "num_episodes": len(trials), "video": False, "command": self.command}
        assemble(self.env, self.folder.staged, root, person=person, **how)

    def _place(self, frame: Mapping[str, Any]) -> tuple[float, float]:
        raw = {name: frame[key] for name, key in self.env.features_map.items() if key in frame}
        return self.view.place(raw)


def open_study(
    env: EnvConfig,
    session: Session,
    view: View,
    assistance: Assistance,
    *,
    root: Path,
    episodes: int,
    seed: int,
    options: Mapping[str, Any],
    command: str,
) -> Study:
    """Begin a study, or take up one that was stopped.

    Args:
        env: The task.
        session: What is driven.
        view: How its task is seen.
        assistance: The session's, set as the person is to be helped.
        root: The study's folder.
        episodes: How many; even.
        seed: Of the first corridor.
        options: The wrapper's options for its adapter.
        command: What was typed, for the dataset's card.

    Raises:
        ValueError: If nothing would help, or the folder holds a study with other settings, or something else.
    """
    how = assistance.settings
    if assistance.adapter is None:
        raise ValueError("a study compares with assistance, and there is no adapter: name one by --policy.adapter")
    settings = {
        "env": {"type": env.type, **env.gym_kwargs},
        "adapter": checkpoint_hash(assistance.adapter),
        "assistance": how.assistance,
        "alpha": how.alpha,
        "fault": how.fault,
        **{name: options.get(name) for name in ("method", "score", "adapter_overrides")},
    }
    folder = StudyFolder(root, settings, episodes, seed)
    helped = f"`{assistance.adapter}`, {how.assistance}, alpha {how.alpha:g}, fault {how.fault}"
    finish = Finish(env, view, folder, helped, command)
    return Study(session, assistance, folder, partial(columns, env), finish)
