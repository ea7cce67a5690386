"""The animation of `gloves drive` for the README: a scripted driver at the keys of a page.

The first episode that succeeds is the one that is shown.

python scripts/animate_drive.py --output=docs/images/drive.gif
"""

import argparse
import io
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from animation import write_gif
from benchmark_drive import Watcher, browser, press, server
from PIL import Image
from selenium.webdriver.common.by import By

from lerobot_gloves.drive.driver import SKILLS, Driver
from lerobot_gloves.drive.slalom import SlalomView

EVERY, WIDTH, COLOURS = 0.25, 800, 64
"""Seconds between two frames, their width and colours: what stays below a megabyte."""


def drive(watcher: Watcher, driver: Any, seed: int) -> list[Image.Image]:
    """Press keys until the episode is over; frames of the page."""
    view = SlalomView()
    seen = SimpleNamespace(place=lambda state: state["place"], steer=view.steer, targets=view.targets)
    person = Driver("gloves_slalom", seen, SKILLS["practised"], seed, watcher.about["task"])
    down, frames, last = set[str](), list[Image.Image](), 0.0
    while watcher.state["phase"] in ("ready", "driving"):
        x, y, _, _ = person.command(watcher.next())
        down = press(driver, down, x, y)
        if time.monotonic() - last > EVERY:
            last = time.monotonic()
            frames.append(Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB"))
    press(driver, down, 0, 0)
    time.sleep(0.5)
    frames += 4 * [Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")]
    print(f"{watcher.state['phase']} after {watcher.state['step']} steps")
    return frames


def main() -> None:
    """Drive, shrink, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=100000, help="of the corridor and the driver")
    parser.add_argument("--output", type=Path, required=True, help="the GIF")
    arguments = parser.parse_args()
    with server(480, f"--seed={arguments.seed}") as (_, address), browser(address) as page:
        page.set_window_size(1280, 830)
        time.sleep(1)
        watcher = Watcher(address)
        while "task" not in watcher.about:
            time.sleep(0.05)
        frames = drive(watcher, page, arguments.seed)
        while watcher.state["phase"] != "success":
            page.find_element(By.ID, "again").click()
            while watcher.next()["phase"] != "ready":
                pass
            frames = drive(watcher, page, arguments.seed)
        watcher.close()
    write_gif(frames, arguments.output, EVERY, WIDTH, COLOURS)


if __name__ == "__main__":
    main()
