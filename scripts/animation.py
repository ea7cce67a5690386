"""Turn the video that `gloves demo` writes into the small animation of the README.

python scripts/animation.py --video=outputs/demo/side_by_side.mp4 --output=docs/images/demo.gif
"""

import argparse
from pathlib import Path

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
    height = round(frames[0].height * WIDTH / frames[0].width)
    small = [frame.resize((WIDTH, height), Image.Resampling.LANCZOS) for frame in frames]
    palette = small[len(small) // 2].quantize(COLOURS)
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    with whole(arguments.output) as file:
        drawn[0].save(
            file,
            format="GIF",
            save_all=True,
            append_images=drawn[1:],
            duration=1000 * EVERY / rate,
            loop=0,
            optimize=True,
        )


if __name__ == "__main__":
    main()
