"""`gloves drive` in a process of its own that begins at once, since it is forked from one that has imported LeRobot.

No thread of this one: MuJoCo's rendering belongs to the thread that draws first.
"""

import multiprocessing
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import lerobot_policy_gloves  # noqa: F401, registers the person and the adapter
from lerobot_gloves.commands.drive import DriveConfig, drive
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.preloaded import fork_forkserver

PATIENCE = 60.0
"""Seconds: a browser without a GPU takes long where other tests run beside it."""


@contextmanager
def served(env: dict[str, Any], **options: Any) -> Iterator[str]:
    """The address of a server that drives Slalom with some options; it is interrupted at the end."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    if "PYTEST_XDIST_WORKER" not in os.environ:  # of whose workers the server is a fork already
        fork_forkserver()
    context = multiprocessing.get_context("forkserver")
    process = context.Process(target=_serve, args=(env, {"port": port, "view": 128, **options}))
    process.start()
    try:
        until(lambda: not process.is_alive() or _listens(port))
        yield f"http://127.0.0.1:{port}/"
        assert process.is_alive()
    finally:
        os.kill(process.pid, signal.SIGINT)
        process.join(PATIENCE)
    assert process.exitcode == 1


def until(condition: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def _serve(env: dict[str, Any], options: dict[str, Any]) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with one_line_errors("gloves drive"):
        drive(DriveConfig(env=SlalomEnv(**env), **options))


def _listens(port: int) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0
