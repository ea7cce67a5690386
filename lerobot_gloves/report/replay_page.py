"""A log that the wrapper wrote, and the videos of its episodes, to one HTML page that needs nothing but itself."""

import base64
import json
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av

TEMPLATE = Path(__file__).with_name("replay.html")
NEEDED = {"episode", "step", "length", "score", "p_value", "edited", "distance", "milliseconds", "evaluations"}
"""What every line of a log has."""


@dataclass(frozen=True)
class Video:
    """An episode's video: its file, its frames, and how many of them a second has."""

    file: Path
    frames: int
    rate: float


def read_episodes(log: Path) -> dict[int, list[dict[str, Any]]]:
    """The chunks of a log by the number of their episode, each in the order of its steps.

    Args:
        log: JSON lines, as `--policy.log` writes them.

    Raises:
        ValueError: If a line is none of a log, there is none, or the log holds several runs.
        OSError: If it cannot be read.
    """
    episodes: dict[int, dict[int, dict[str, Any]]] = defaultdict(dict)
    for number, text in enumerate(log.read_text().splitlines(), start=1):
        try:
            line = json.loads(text)
            if missing := NEEDED - line.keys():
                raise ValueError(f"{', '.join(sorted(missing))} missing")
            chunks, step = episodes[int(line["episode"])], int(line["step"])
        except (ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"line {number} of {log} is none that --policy.log writes: {error}") from error
        if step in chunks:
            raise ValueError(
                f"{log} holds step {step} of episode {line['episode']} twice: of several runs in one log nobody knows "
                "which is which, so let each write its own"
            )
        chunks[step] = line
    if not episodes:
        raise ValueError(f"{log} holds no chunks")
    return {number: [chunks[step] for step in sorted(chunks)] for number, chunks in sorted(episodes.items())}


def find_videos(place: Path) -> dict[int, Video]:
    """Videos by the number of their episode, which is the last in a file's name: `eval_episode_3.mp4`.

    Args:
        place: A file, or a folder that holds them, at any depth.

    Raises:
        ValueError: If there are none, two are of the same episode, or one cannot be read.
    """
    files = [place] if place.is_file() else sorted(place.rglob("*.mp4"))
    found: dict[int, Video] = {}
    for file in files:
        named = re.findall(r"\d+", file.stem)
        if not named:
            raise ValueError(f"the name of {file} does not say which episode it shows: name it such as episode_3.mp4")
        if (number := int(named[-1])) in found:
            raise ValueError(
                f"{found[number].file} and {file} are both of episode {number}: name the folder of one run"
            )
        try:
            with av.open(str(file)) as container:
                stream = container.streams.video[0]
                found[number] = Video(file, stream.frames, float(stream.average_rate or 0) or 1.0)
        except (av.FFmpegError, IndexError) as error:
            raise ValueError(f"{file} is no video: {error}") from error
    if not found:
        raise ValueError(f"{place} holds no videos (*.mp4)")
    return found


def replay_html(
    episodes: Mapping[int, Sequence[Mapping[str, Any]]], videos: Mapping[int, Video], *, about: str, rate: float
) -> str:
    """The page.

    Args:
        episodes: The chunks of each, by its number.
        videos: Those of some of them.
        about: What the page says that it shows.
        rate: Steps a second of episodes without a video.
    """
    told = {
        "about": about,
        "fps": next((video.rate for number, video in videos.items() if number in episodes), rate),
        "episodes": [_episode(number, chunks, videos.get(number)) for number, chunks in episodes.items()],
    }
    # JSON has no infinity, and a number beyond all that can be held is read as one; nothing may end the element.
    text = json.dumps(told).replace("Infinity", "1e999").replace("<", "\\u003c")
    return TEMPLATE.read_text().replace("DATA", text, 1)


def _episode(number: int, chunks: Sequence[Mapping[str, Any]], video: Video | None) -> dict[str, Any]:
    ends = [int(chunk["step"]) for chunk in chunks[1:]]
    steps = max(chunks[-1]["step"] + chunks[-1]["length"], *ends, 1)
    if video is not None:
        steps = max(video.frames, chunks[-1]["step"] + 1)  # a frame before each step, and one behind the last
    shown = [{**chunk, "runs": end - chunk["step"]} for chunk, end in zip(chunks, [*ends, steps], strict=True)]
    actions = [action for chunk in chunks for name in ("proposed", "executed") for action in chunk.get(name, [])]
    return {
        "number": number,
        "steps": steps,
        "chunks": shown,
        "ranges": [[min(entry), max(entry)] for entry in zip(*actions, strict=True)],
        "video": None
        if video is None
        else f"data:video/mp4;base64,{base64.b64encode(video.file.read_bytes()).decode()}",
    }


def chosen[T](episodes: Mapping[int, T], numbers: Collection[int] | None) -> dict[int, T]:
    """The episodes with these numbers; all for None.

    Raises:
        ValueError: If the log has none of such a number.
    """
    if numbers is None:
        return dict(episodes)
    if missing := sorted(set(numbers) - episodes.keys()):
        known = ", ".join(map(str, episodes))
        raise ValueError(f"the log has no episode {', '.join(map(str, missing))}: choose from {known}")
    return {number: episodes[number] for number in sorted(numbers)}
