"""What the demo's runs look like: the picture of all paths, the video of one episode."""

from pathlib import Path

import numpy as np

from lerobot_gloves.demo import picture, video
from lerobot_gloves.demo.evaluation import Comparison, PlayedRun
from lerobot_gloves.demo.replay import replay
from lerobot_gloves.system.files import whole
from lerobot_gloves.tasks.slalom.scene import MODES

PICTURE, VIDEO = "paths.png", "side_by_side.mp4"


def show(comparison: Comparison, raw: PlayedRun, corrected: PlayedRun, folder: Path) -> str:
    """Draw the picture and the video into a folder; returns what the video shows."""
    draw_paths(comparison, raw, corrected, folder / PICTURE)
    return write_video(comparison, raw, corrected, folder / VIDEO)


def draw_paths(comparison: Comparison, raw: PlayedRun, corrected: PlayedRun, file: Path) -> None:
    """The picture of all episodes of two runs."""
    panels = {
        played.run.label: [replay(played, i, comparison.seed + i) for i in range(comparison.episodes)]
        for played in (raw, corrected)
    }
    corridors = min(comparison.episodes, len(MODES))
    episodes = f"the same {comparison.episodes} episodes of {corridors} corridors"
    figure = picture.draw(panels, f"The same agent ({comparison.perturbation}) in {episodes}")
    with whole(file) as part:
        figure.savefig(part, format="png")


def write_video(comparison: Comparison, raw: PlayedRun, corrected: PlayedRun, file: Path) -> str:
    """The video of the first episode in which the raw agent fails and the corrected one succeeds.

    Returns:
        What it shows. Without such an episode there is no video, and this says so.
    """
    saved = [i for i in range(comparison.episodes) if corrected.successes[i] and not raw.successes[i]]
    if not saved:
        file.unlink(missing_ok=True)
        return f"No video: in no episode does the raw agent fail and {corrected.run.label} succeed."
    seed = comparison.seed + saved[0]
    panels = [
        video.Panel(
            played.run.label, replay(played, saved[0], seed, image_size=video.RENDERED), edited(played, saved[0])
        )
        for played in (raw, corrected)
    ]
    mode = MODES[seed % len(MODES)]
    chosen = f"the first episode in which the raw agent fails and {corrected.run.label} succeeds"
    caption = (
        f"{comparison.perturbation}. Seed {seed}, corridor {mode} (rings), chosen from the results:\n"
        f"{chosen}. Grey: as the agent proposed. Teal: edited."
    )
    video.write(panels, mode, caption, file)
    return f"{file.name} shows seed {seed}, corridor {mode}, chosen from the results: {chosen}."


def edited(played: PlayedRun, episode: int) -> list[bool]:
    """Whether an action of an episode was edited, per step."""
    steps = np.zeros(len(played.actions[episode]), dtype=bool)
    for chunk in played.chunks:
        if chunk["episode"] == episode:
            steps[chunk["step"] : chunk["step"] + chunk["length"]] = chunk["edited"]
    return steps.tolist()
