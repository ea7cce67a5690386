"""`gloves replay`: every edit of an episode, on a page that one scrubs through."""

import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot.configs import parser

from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.report.replay_page import chosen, find_videos, read_episodes, replay_html
from lerobot_gloves.system.files import write_text


@dataclass
class ReplayConfig:
    """Turn a log of the wrapper, and the videos of its episodes, into one page that needs no other file.

    gloves replay outputs/log.jsonl --videos=outputs/eval/videos
    """

    # The file that --policy.log wrote; may be named without --log=, as the first argument.
    log: Path
    # Folder of the episodes' videos, such as the one that lerobot-eval leaves in its --output_dir, or one file.
    videos: Path | None = None
    # The page; by default beside the log, with the ending .html.
    output: Path | None = None
    # Numbers of the episodes to show, such as '[0, 3]'; all by default.
    episodes: list[int] | None = None
    # Steps a second, where no video says it.
    fps: float = 20

    def __post_init__(self) -> None:
        if self.fps <= 0:
            raise ValueError(f"fps is {self.fps}, but must be above 0")


@parser.wrap()
def replay(config: ReplayConfig) -> None:
    """Write the page."""
    log = config.log.expanduser()
    episodes = chosen(read_episodes(log), config.episodes)
    videos = {} if config.videos is None else find_videos(config.videos.expanduser())
    if videos and not videos.keys() & episodes.keys():
        raise ValueError(f"the videos in {config.videos} are of none of the episodes {', '.join(map(str, episodes))}")
    chunks = [chunk for several in episodes.values() for chunk in several]
    edited = sum(chunk["edited"] for chunk in chunks)
    about = f"{log.name}: {len(episodes)} episodes, {len(chunks)} chunks, {100 * edited / len(chunks):.1f} % edited."
    page = config.output or log.with_suffix(".html")
    write_text(page, replay_html(episodes, videos, about=about, rate=config.fps))
    print(f"gloves replay: {about} Open {page} ({page.stat().st_size / 1e6:.1f} MB) in a browser.")


def main() -> None:
    """Entry point."""
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-"):
        sys.argv[1] = f"--log={sys.argv[1]}"
    with one_line_errors("gloves replay"):
        replay()
