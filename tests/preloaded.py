"""Commands in processes of their own that begin at once: forked from a server that has imported LeRobot.

Importing LeRobot takes ten seconds of a core, and dozens of tests start commands. What runs is the installed command,
with its own arguments, environment, folder, streams and signals; what it would import is there already. Environment
variables that are read on import come too late; of these `HF_ENDPOINT` is looked at all the same, with `HF_HOME` beside
it, since that is where a test has its Hub. Who needs another starts Python itself.
"""

import array
import contextlib
import faulthandler
import fcntl
import json
import multiprocessing.forkserver
import multiprocessing.util
import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROGRAMS = ("gloves", "lerobot-eval", "lerobot-train")


class Started:
    """A command that runs, by the names of `subprocess.Popen`; it leads a session and a group of its own.

    Args:
        words: Program, one of `PROGRAMS`, and its arguments.
    """

    def __init__(self, *words: str) -> None:
        reads, writes = zip(*(os.pipe() for _ in range(2)), strict=True)
        for pipe in writes:
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 1 << 20)  # it is read at the end
        self._printed = [os.fdopen(pipe) for pipe in reads]
        with open(os.devnull) as nothing:
            streams = [nothing.fileno(), *writes]
            self._connection, self.pid = _ask(server() / "socket", words, streams, session=True)
        for pipe in writes:
            os.close(pipe)
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Its exit status, None while it runs."""
        return self._wait(0)

    def wait(self, timeout: float | None = None) -> int:
        status = self._wait(timeout)
        if status is None:
            raise TimeoutError(f"it still runs after {timeout} s")
        return status

    def _wait(self, timeout: float | None) -> int | None:
        if self.returncode is None:
            self._connection.settimeout(timeout)
            try:
                self.returncode = int(self._connection.recv(16))
            except (BlockingIOError, TimeoutError):
                return None
            self._connection.close()
        return self.returncode

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What was printed on both streams, once it has ended and nobody is left who could print more."""
        self.wait(timeout)
        printed, errors = (file.read() for file in self._printed)
        return printed, errors


@cache
def server() -> Path:
    """The folder of the server, which is begun if need be: programs of the names of `PROGRAMS` that ask it.

    A program killed takes what it began with it. All workers of pytest-xdist share a server, which ends with the
    process that began them, and is nobody's child, since there are tests that count theirs.
    """
    owner = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()
    folder = Path(tempfile.gettempdir()) / f"gloves-tests-{owner}"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "socket").exists():
            _begin(folder, owner)
    return folder


def _begin(folder: Path, owner: int) -> None:
    for name in PROGRAMS:
        program = folder / name
        code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from tests.preloaded import ask; ask({str(folder)!r})"
        program.write_text(f"#!{sys.executable} -IS\n{code}\n")
        program.chmod(0o755)
    code = f"import os\nif not os.fork():\n from tests.preloaded import serve\n serve({str(folder)!r}, {owner})()"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    while not (folder / "socket").exists():
        time.sleep(0.05)  # pytest's own timeout ends this


def ask(folder: str) -> None:
    """What the programs of a server's folder do: what they are called."""
    words = [Path(sys.argv[0]).name, *sys.argv[1:]]
    connection, pid = _ask(Path(folder) / "socket", words, [0, 1, 2])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: os.kill(pid, number))
    status = int(connection.recv(16))
    if status < 0:
        signal.signal(-status, signal.SIG_DFL)
        os.kill(os.getpid(), -status)
    sys.exit(status)


def _ask(
    address: Path, words: list[str] | tuple[str, ...], streams: list[int], **options: object
) -> tuple[socket.socket, int]:
    request = {"words": words, "cwd": os.getcwd(), "environ": dict(os.environ), **options}
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    connection.connect(str(address))
    rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", streams))]
    connection.sendmsg([json.dumps(request).encode()], rights)
    return connection, int(connection.recv(16))


def remember_docstrings() -> None:
    """Let draccus read an option's help once, not for every parser: most of what it takes to read a command line."""
    from draccus.wrappers import docstring

    docstring.get_attribute_docstring = cache(docstring.get_attribute_docstring)


def serve(folder: str, owner: int) -> Callable[[], None]:
    """Fork a process for every request while the process `owner` lives; return, in the new one, what it has to do."""
    owner_ends = os.pidfd_open(owner)

    import lerobot_gloves.commands.bench
    import lerobot_gloves.commands.calibrate
    import lerobot_gloves.commands.record
    import lerobot_gloves.evaluation.preloaded  # noqa: F401

    remember_docstrings()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(f"{folder}/new")
    listener.listen(8)
    os.rename(f"{folder}/new", f"{folder}/socket")
    selector = selectors.DefaultSelector()
    selector.register(listener, selectors.EVENT_READ)
    selector.register(owner_ends, selectors.EVENT_READ)
    running: dict[int, tuple[int, socket.socket]] = {}
    while True:
        for key, _ in selector.select():
            if key.fileobj is listener:
                connection, _ = listener.accept()
                message, streams, _, _ = socket.recv_fds(connection, 1 << 20, 3)
                request = json.loads(message)
                pid = os.fork()
                if pid == 0:
                    for file in (listener, connection, selector):
                        file.close()
                    return _prepared(request, streams)
                for stream in streams:
                    os.close(stream)
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    connection.send(str(pid).encode())
                ends = os.pidfd_open(pid)
                running[ends] = pid, connection
                selector.register(ends, selectors.EVENT_READ)
                selector.register(connection, selectors.EVENT_READ, ends)
            elif key.fileobj == owner_ends:
                for pid, _ in running.values():
                    os.kill(pid, signal.SIGKILL)
                shutil.rmtree(folder)
                sys.exit()
            elif key.data is None:
                pid, connection = running.pop(key.fd)
                selector.unregister(connection)
                selector.unregister(key.fd)
                os.close(key.fd)
                _, status = os.waitpid(pid, 0)
                # Nobody may be left to be told.
                with connection, contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    connection.send(str(os.waitstatus_to_exitcode(status)).encode())
            elif key.data in running and running[key.data][1] is key.fileobj:  # it may have ended a moment ago
                os.kill(running[key.data][0], signal.SIGKILL)  # whoever asked is dead


def _prepared(request: dict, streams: list[int]) -> Callable[[], None]:
    """Become the process that a request describes."""
    from importlib.metadata import entry_points

    if request.get("session"):
        os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environ"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if "HF_ENDPOINT" in os.environ:
        _move_the_hub(os.environ["HF_ENDPOINT"], Path(os.environ["HF_HOME"]))
    faulthandler.enable()  # on the standard error that is its own now
    fork_forkserver()
    sys.argv = request["words"]
    (command,) = entry_points(group="console_scripts", name=sys.argv[0])
    main = command.load()
    return lambda: sys.exit(main())


def _move_the_hub(url: str, home: Path) -> None:
    """Have what is imported already ask the Hub at `url`, and keep what comes from it in `home`."""
    from huggingface_hub import constants

    for name, value in hub_at(url, home / "hub").items():
        setattr(constants, name, value)
    lerobots = {"HF_LEROBOT_HOME": home / "lerobot", "HF_LEROBOT_HUB_CACHE": home / "lerobot" / "hub"}
    for module in [module for name, module in sys.modules.items() if name.partition(".")[0] == "lerobot"]:
        for name in lerobots.keys() & vars(module).keys():  # each module has them by `from`
            setattr(module, name, lerobots[name])


def hub_at(url: str, cache: Path) -> dict[str, object]:
    """The constants of `huggingface_hub` for a Hub at `url` whose files are kept in `cache`."""
    return {
        "ENDPOINT": url,
        "HUGGINGFACE_CO_URL_TEMPLATE": url + "/{repo_id}/resolve/{revision}/{filename}",
        "HF_HUB_OFFLINE": False,
        "HF_HUB_DISABLE_XET": True,
        "HF_HUB_CACHE": str(cache),
    }


def fork_forkserver() -> None:
    """Let the server of `multiprocessing` that this process begins be a fork of it, which has imported LeRobot."""
    spawn = multiprocessing.util.spawnv_passfds

    def begin(path: bytes, arguments: list[str], streams: list[int]) -> int:
        code = arguments[-1]
        if "multiprocessing.forkserver" not in code:
            return spawn(path, arguments, streams)
        pid = os.fork()
        if pid == 0:
            try:
                _as_if_executed(streams)
                exec(code)
            finally:
                os._exit(0)  # it ends by an exception, of which those who called this are not to hear
        return pid

    multiprocessing.util.spawnv_passfds = begin


def _as_if_executed(streams: list[int]) -> None:
    """Give up what a fork keeps and a program that is executed does not: handlers, files, who holds a lock."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    multiprocessing.forkserver._forkserver._lock = threading.Lock()
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in map(int, os.listdir("/proc/self/fd")):
        if number > 2 and number not in streams:  # a number that was free would be another's when its owner closes it
            with contextlib.suppress(OSError):
                os.dup2(nothing, number)
