"""How steadily `gloves drive` runs: steps a second, the time from a key to the frame that moved, and memory.

A browser without a window presses keys on the page, and a second page watches when steps come. Both run on this
machine, as a driver's would. Needs Chromium and chromedriver.

    python scripts/benchmark_drive.py --minutes=10
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from websockets.sync.client import connect

from lerobot_gloves.system.text import markdown_table

HOLD = 0.5
"""Seconds that a key is held, and that none is after it."""
LISTEN = """
window.delays = [];
let pressed = null, moved = false;
const reading = document.getElementById("reading");
addEventListener("keydown", (event) => {
  if (event.code.startsWith("Arrow") && !event.repeat) { pressed = performance.now(); moved = false; }
}, true);
new MutationObserver(() => { moved ||= !/^(Standing still|Nothing)/.test(reading.textContent); })
  .observe(reading, { childList: true, characterData: true, subtree: true });
document.getElementById("camera").addEventListener("load", () => {
  if (pressed === null || !moved) return;
  delays.push(performance.now() - pressed);
  pressed = null;
});
"""
"""A step that executes a command is told before its frame: the first frame loaded after it is the first that moved."""


@contextmanager
def server(view: int, *options: str) -> Iterator[tuple[psutil.Process, str]]:
    """The process of `gloves drive`, and its address."""
    command = [Path(sys.executable).with_name("gloves"), "drive", "--env.type=gloves_slalom"]
    with tempfile.NamedTemporaryFile("r") as log, Path(log.name).open("w") as stream:
        started = subprocess.Popen([*command, "--port=0", f"--view={view}", *options], stdout=stream, stderr=stream)
        try:
            while not (found := re.search(r"open (http://\S+)", Path(log.name).read_text())):
                if started.poll() is not None:
                    sys.exit(Path(log.name).read_text())
                time.sleep(0.1)
            yield psutil.Process(started.pid), found[1]
        finally:
            started.terminate()
            started.wait()


@contextmanager
def browser(address: str) -> Iterator[webdriver.Chrome]:
    """Chromium with the page open."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1280,900"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        driver.get(address)
        yield driver
    finally:
        driver.quit()


class Watcher(threading.Thread):
    """A page that watches: when steps come, and how many frames.

    Attributes:
        about: What was last told of the episode.
        state: What was last told of its step.
        gaps: Seconds between two steps of one episode, one after the other: as the server took them, and as they were
            told here.
        frames: Pictures.
    """

    def __init__(self, address: str):
        super().__init__(daemon=True)
        self.about, self.state = dict[str, Any](), {"phase": ""}
        self.gaps, self.frames = list[tuple[float, float]](), 0
        self._news = threading.Event()
        self._socket = connect(address.replace("http", "ws") + "socket", max_size=None)
        self.start()

    def next(self) -> dict[str, Any]:
        """Wait for the next step, and what is told of it."""
        self._news.clear()
        self._news.wait(5)
        return self.state

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self.join()

    def run(self) -> None:
        before: tuple[int, int, float, float] | None = None
        for message in self._socket:
            if isinstance(message, bytes):
                self.frames += 1
                continue
            told: dict[str, Any] = json.loads(message)
            if told["type"] == "about":
                self.about = told
            if told["type"] != "state":
                continue
            now, self.state = time.monotonic(), told
            self._news.set()
            this = (told["episode"], told["step"], told["time"], now)
            if before is not None and this[0] == before[0] and this[1] == before[1] + 1 > 1:
                self.gaps.append((this[2] - before[2], this[3] - before[3]))
            if before is None or this[:2] != before[:2]:
                before = this


def press(driver: webdriver.Chrome, down: set[str], x: float, y: float) -> set[str]:
    """Hold the arrows of a direction and let go of the others; those that are held now."""
    sides = ((x > 0, Keys.ARROW_RIGHT), (x < 0, Keys.ARROW_LEFT), (y > 0, Keys.ARROW_UP), (y < 0, Keys.ARROW_DOWN))
    wanted, chain = {key for held, key in sides if held}, ActionChains(driver, duration=0)
    for key in down - wanted:
        chain.key_up(key)
    for key in wanted - down:
        chain.key_down(key)
    chain.perform()
    return wanted


def drive(driver: webdriver.Chrome, watcher: Watcher, seconds: float) -> None:
    """Press one arrow after the other, and begin again whenever an episode is over."""
    end, keys = time.monotonic() + seconds, [Keys.ARROW_LEFT, Keys.ARROW_RIGHT]
    while time.monotonic() < end:
        if watcher.state["phase"] in ("success", "failure"):
            ActionChains(driver).send_keys("r").pause(0.2).perform()
        keys.reverse()
        ActionChains(driver).key_down(keys[0]).pause(HOLD).key_up(keys[0]).pause(HOLD).perform()


def in_words(milliseconds: np.ndarray) -> str:
    """Median and 99th percentile."""
    return f"{np.median(milliseconds):.0f}, {np.quantile(milliseconds, 0.99):.0f}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--view", type=int, default=480, help="height and width of the picture")
    arguments = parser.parse_args()
    with server(arguments.view) as (process, address), browser(address) as driver:
        driver.execute_script(LISTEN)
        time.sleep(1)  # the page is the driver, the watcher comes after it
        watcher = Watcher(address)
        drive(driver, watcher, 30)
        driver.execute_script("delays.length = 0;")
        watcher.gaps.clear()
        watcher.frames, memory = 0, process.memory_info().rss
        began = time.monotonic()
        drive(driver, watcher, 60 * arguments.minutes - 30)
        taken, grown = time.monotonic() - began, process.memory_info().rss - memory
        gaps, delays = 1000 * np.array(watcher.gaps), np.array(driver.execute_script("return delays;"))
        watcher.close()
    print(
        markdown_table(
            [
                ["after half a minute of driving, until", f"{arguments.minutes:g} minutes"],
                ["steps a second while an episode is on", f"{1000 / gaps[:, 0].mean():.2f}"],
                ["between two steps: median, 99th percentile, ms", in_words(gaps[:, 0])],
                ["the same, as a page that watches is told of them", in_words(gaps[:, 1])],
                ["frames a second", f"{watcher.frames / taken:.1f}"],
                ["key to moved frame: median, 99th percentile, ms", in_words(delays)],
                ["keys pressed", str(len(delays))],
                ["memory: at first, grown by, MiB", f"{memory / 2**20:.0f}, {grown / 2**20:.1f}"],
            ]
        )
    )


if __name__ == "__main__":
    main()
