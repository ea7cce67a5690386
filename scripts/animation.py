"""Turn the video that `gloves demo` writes into the small animation of the README.

python scripts/animation.py --video=outputs/demo/side_by_side.mp4 --output=docs/images/demo.gif
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
from PIL import Image

from lerobot_gloves.system.files import whole

EVERY, WIDTH, COLOURS = 3, 640, 48
"""Of the frames one in so many, how wide, and in how many colours: what stays below a megabyte."""


def main() -> None:
    """Decode, shrink, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--video", type=Path, required=True, help="what gloves demo wrote")
    parser.add_argument("--output", type=Path, required=True, help="the GIF")
    arguments = parser.parse_args()
    with av.open(str(arguments.video)) as container:
        rate = float(container.streams.video[0].average_rate)
        frames = [frame.to_image() for frame in container.decode(video=0)][::EVERY]
    write_gif(frames, arguments.output, EVERY / rate, WIDTH, COLOURS)


def write_gif(frames: Sequence[Image.Image], output: Path, seconds: float, width: int, colours: int) -> None:
    """Write a GIF that goes round for ever, each frame for so long, in the colours of the one in the middle."""
    height = round(frames[0].height * width / frames[0].width)
    small = [frame.resize((width, height), Image.Resampling.LANCZOS) for frame in frames]
    palette = small[len(small) // 2].quantize(colours)
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    options: dict[str, Any] = {"append_images": drawn[1:], "duration": 1000 * seconds, "loop": 0, "optimize": True}
    with whole(output) as file:
        drawn[0].save(file, format="GIF", save_all=True, **options)


if __name__ == "__main__":
    main()
