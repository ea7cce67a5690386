"""What the demo's runs look like: the picture of all paths, the video of one episode."""

from pathlib import Path

import numpy as np

from lerobot_gloves.demo import picture, video
from lerobot_gloves.demo.evaluation import Result, Setting
from lerobot_gloves.demo.replay import replay
from lerobot_gloves.tasks.slalom.scene import MODES

PICTURE, VIDEO = "paths.png", "side_by_side.mp4"


def show(setting: Setting, raw: Result, corrected: Result, folder: Path) -> str:
    """Draw the picture and the video into a folder; returns what the video shows."""
    draw_paths(setting, raw, corrected, folder / PICTURE)
    return write_video(setting, raw, corrected, folder / VIDEO)


def draw_paths(setting: Setting, raw: Result, corrected: Result, file: Path) -> None:
    """The picture of all episodes of two runs."""
    panels = {
        result.method.label: [replay(result, i, setting.seed + i) for i in range(setting.episodes)]
        for result in (raw, corrected)
    }
    corridors = min(setting.episodes, len(MODES))
    title = f"The same agent ({setting.perturbation}) in the same {setting.episodes} episodes of {corridors} corridors"
    picture.draw(panels, title).savefig(file)


def write_video(setting: Setting, raw: Result, corrected: Result, file: Path) -> str:
    """The video of the first episode in which the raw agent fails and the corrected one succeeds.

    Returns:
        What it shows. Without such an episode there is no video, and this says so.
    """
    saved = [i for i in range(setting.episodes) if corrected.successes[i] and not raw.successes[i]]
    if not saved:
        file.unlink(missing_ok=True)
        return f"No video: in no episode does the raw agent fail and {corrected.method.label} succeed."
    seed = setting.seed + saved[0]
    panels = [
        video.Panel(
            result.method.label, replay(result, saved[0], seed, image_size=video.RENDERED), edited(result, saved[0])
        )
        for result in (raw, corrected)
    ]
    mode = MODES[seed % len(MODES)]
    chosen = f"the first episode in which the raw agent fails and {corrected.method.label} succeeds"
    caption = (
        f"{setting.perturbation}. Seed {seed}, corridor {mode} (rings), chosen from the results:\n"
        f"{chosen}. Grey: as the agent proposed. Teal: edited."
    )
    video.write(panels, mode, caption, file)
    return f"{file.name} shows seed {seed}, corridor {mode}, chosen from the results: {chosen}."


def edited(result: Result, episode: int) -> list[bool]:
    """Whether an action of an episode was edited, per step."""
    steps = np.zeros(len(result.actions[episode]), dtype=bool)
    for chunk in result.chunks:
        if chunk["episode"] == episode:
            steps[chunk["step"] : chunk["step"] + chunk["length"]] = chunk["edited"]
    return steps.tolist()
