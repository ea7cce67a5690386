"""Commands as subprocesses, some side by side, with one line of progress for all of them."""

import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

LAST_LINES = 15
"""How much of a failed command's log is shown."""


@dataclass(frozen=True, eq=False)
class Command:
    """A command to run.

    Attributes:
        label: What the user reads.
        words: Program and arguments.
        log: File that receives all it prints.
        progress: Finds "done" and "total" in what it prints; the last match counts.
    """

    label: str
    words: Sequence[str]
    log: Path
    progress: re.Pattern[str]


def console_script(name: str) -> str:
    """Path of a command that is installed in this Python environment.

    Raises:
        FileNotFoundError: If it is not.
    """
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        raise FileNotFoundError(f"{name} is not installed beside {sys.executable}: install the package with its extras")
    return str(path)


def clock(seconds: float) -> str:
    """Minutes and seconds, such as 1:05."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def run(commands: Sequence[Command], *, began: float) -> None:
    """Run commands to their end, as `ended` does."""
    for _ in ended(commands, began=began):
        pass


def ended(commands: Sequence[Command], *, began: float, width: int = 2) -> Generator[Command]:
    """Run commands, at most `width` at a time, and say how far they are.

    A command takes one thread, asks nothing of the Hub, and ends when this process does.

    Args:
        commands: In the order in which they are started.
        began: When all of it began (`time.monotonic`), for the elapsed time.
        width: How many run side by side.

    Yields:
        Each command when it has ended.

    Raises:
        ChildProcessError: If one fails. Its last lines are on standard error; the others have been ended.
    """
    waiting, running = deque(commands), dict[Command, tuple[subprocess.Popen, float]]()
    try:
        while waiting or running:
            while waiting and len(running) < width:
                command = waiting.popleft()
                running[command] = _start(command), time.monotonic()
            time.sleep(0.1)
            for command, (process, started) in list(running.items()):
                if process.poll() is None:
                    continue
                del running[command]
                if process.returncode != 0:
                    raise _failure(command, process.returncode)
                _show("")
                now = time.monotonic()
                print(f"[{clock(now - began)}] {command.label}: {clock(now - started)}", flush=True)
                yield command
            _show(f"[{clock(time.monotonic() - began)}] " + " | ".join(map(_status, running)))
    finally:
        _show("")
        _end([process for process, _ in running.values()])


def _start(command: Command) -> subprocess.Popen:
    command.log.parent.mkdir(parents=True, exist_ok=True)
    settings = {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"}
    with command.log.open("wb") as log:
        return subprocess.Popen(
            command.words,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=os.environ | settings,
            preexec_fn=_prepare_to_end,
        )


def _prepare_to_end() -> None:
    """Listen to interrupts, and get one when the parent dies: nobody would know of what still runs and writes."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # in the background, shells let commands ignore it
    if sys.platform == "linux":
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGINT)


def _end(processes: Sequence[subprocess.Popen]) -> None:
    """Interrupt processes, which lets them end their own; kill those that do not listen."""
    for process in processes:
        process.send_signal(signal.SIGINT)
    for process in processes:
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _status(command: Command) -> str:
    """How far a command is."""
    *_, last = [None, *command.progress.finditer(_tail(command.log))]
    return f"{command.label}: starting" if last is None else f"{command.label}: {last['done']} of {last['total']}"


def _tail(log: Path, size: int = 8192) -> str:
    with log.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - size))
        return file.read().decode(errors="replace")


def _failure(command: Command, status: int) -> ChildProcessError:
    lines = [line for line in _tail(command.log).replace("\r", "\n").splitlines() if line.strip()]
    print("\n".join(lines[-LAST_LINES:]), file=sys.stderr)
    return ChildProcessError(f"{command.label} failed with exit status {status}; all it printed is in {command.log}")


def _show(line: str) -> None:
    """Replace the terminal's last line; where there is no terminal, say nothing."""
    if sys.stdout.isatty():
        print(f"\r\x1b[K{line[: shutil.get_terminal_size().columns - 1]}", end="", flush=True)
