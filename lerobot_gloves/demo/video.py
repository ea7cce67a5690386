"""The video: the raw agent on the left, the corrected one on the right, in the same episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from lerobot.utils.io_utils import write_video
from PIL import Image, ImageDraw, ImageFont

from lerobot_gloves.demo.replay import Path2d
from lerobot_gloves.tasks.environment import CONTROL_HZ
from lerobot_gloves.tasks.slalom.expert import GAP_CENTRES
from lerobot_gloves.tasks.slalom.scene import CAMERA, ROW_Y, TIP_HEIGHT, model, parse_mode

RENDERED, SHOWN = 768, 480
"""Side of the square that is drawn, and of what is shown of it, both in pixels: drawn larger, edges are smooth."""
CROP = (84, 150, 712, 768)
"""Left, upper, right, lower edge of the part that is shown, in pixels of the square: the table, not the sky."""
HEADER, FOOTER, GUTTER = 56, 64, 8
HOLD = 2.0
"""Seconds that the last frame stays."""
PAPER, INK, FAINT = (255, 255, 255), (34, 39, 46), (110, 118, 125)
OWN, EDITED, SUCCESS, FAILURE = (73, 80, 87), (12, 133, 153), (47, 158, 68), (217, 72, 15)


@dataclass(frozen=True)
class Panel:
    """One side of the video.

    Attributes:
        label: Above it.
        path: The episode, with frames of side `RENDERED`.
        edited: Whether an action was edited, per step, (L,).
    """

    label: str
    path: Path2d
    edited: Sequence[bool]


def write(panels: Sequence[Panel], mode: str, caption: str, file: Path) -> None:
    """Write the panels side by side; the shorter episode waits for the longer one at its end.

    Args:
        panels: From left to right.
        mode: The requested corridor, such as "0 2 3", marked on the floor.
        caption: Below them, up to two lines.
        file: An MP4.
    """
    steps = max(len(panel.path.tips) for panel in panels)
    frames = [_frame(panels, step, mode, caption) for step in range(steps)]
    frames += frames[-1:] * round(HOLD * CONTROL_HZ)
    write_video(file, frames, CONTROL_HZ)


def _frame(panels: Sequence[Panel], step: int, mode: str, caption: str) -> np.ndarray:
    height = round(SHOWN * (CROP[3] - CROP[1]) / (CROP[2] - CROP[0]) / 2) * 2
    width = SHOWN * len(panels) + GUTTER * (len(panels) - 1)
    canvas = Image.new("RGB", (width, HEADER + height + FOOTER), PAPER)
    text = ImageDraw.Draw(canvas)
    for number, panel in enumerate(panels):
        left = number * (SHOWN + GUTTER)
        now = min(step, len(panel.path.tips) - 1)
        picture = _picture(panel, now, mode).crop(CROP).resize((SHOWN, height), Image.Resampling.LANCZOS)
        canvas.paste(picture, (left, HEADER))
        text.text((left + 14, HEADER // 2), panel.label, INK, _font(22, bold=True), anchor="lm")
        over = now == len(panel.path.tips) - 1
        word, colour = _state(panel, now) if not over else _outcome(panel.path.failure)
        text.text((left + SHOWN - 14, HEADER // 2), word, colour, _font(19, bold=over), anchor="rm")
    text.multiline_text((14, HEADER + height + FOOTER // 2), caption, FAINT, _font(15), anchor="lm", spacing=6)
    return np.asarray(canvas)


def _state(panel: Panel, step: int) -> tuple[str, tuple[int, int, int]]:
    return ("edited", EDITED) if panel.edited[step] else ("as proposed", OWN)


def _outcome(failure: str) -> tuple[str, tuple[int, int, int]]:
    return (failure.replace("_", " "), FAILURE) if failure else ("goal reached", SUCCESS)


def _picture(panel: Panel, step: int, mode: str) -> Image.Image:
    """A rendered frame with the requested gaps and the tip's way so far drawn on the table."""
    assert panel.path.frames is not None
    frame = panel.path.frames[step]
    drawn = Image.fromarray(frame)
    pen = ImageDraw.Draw(drawn)
    angles = np.linspace(0, 2 * np.pi, 40)
    for row, gap in enumerate(parse_mode(mode)):
        x, y = GAP_CENTRES[row][gap], ROW_Y[row]
        ring = np.stack([x + 0.022 * np.cos(angles), y + 0.022 * np.sin(angles), 0 * angles], axis=1)
        pen.line(_pixels(ring), SUCCESS, 5, joint="curve")
    tips = panel.path.tips[: step + 1]
    trail = _pixels(np.column_stack([tips, np.full(len(tips), TIP_HEIGHT)]))
    for k in range(step):
        pen.line(trail[k : k + 2], EDITED if panel.edited[k] else OWN, 7, joint="curve")
    picture = Image.fromarray(frame)
    picture.paste(drawn, mask=Image.fromarray(_table(frame)))
    return picture


def _table(frame: np.ndarray) -> np.ndarray:
    """255 where a frame shows the table or a line on it, 0 where the grey arm or a red pillar stands before it."""
    red, green, blue = np.moveaxis(frame.astype(np.int16), -1, 0)
    return np.where((np.abs(red - blue) < 15) | (red - green > 60), 0, 255).astype(np.uint8)


def _pixels(points: np.ndarray) -> list[tuple[float, float]]:
    """Where the camera sees points (n, 3) of the scene, in pixels of a rendered frame."""
    camera = model(visual=True).camera(CAMERA)
    away = points - camera.pos
    right, up, backward = _axes(camera.quat)
    focal = RENDERED / 2 / np.tan(np.radians(camera.fovy[0]) / 2)
    depth = -(away @ backward)
    columns, rows = RENDERED / 2 + focal * (away @ right) / depth, RENDERED / 2 - focal * (away @ up) / depth
    return list(zip(columns.tolist(), rows.tolist(), strict=True))


def _axes(quaternion: np.ndarray) -> np.ndarray:
    """Rows: the right, up and backward axes of a camera of that orientation (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Matplotlib's own font, which is there on every machine."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)
