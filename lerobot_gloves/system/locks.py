"""Locks that die with their owner, so that no two runs play the same cell, and none stays behind."""

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class Lock:
    """A file that one process at a time can hold, on one machine or on several that share the disk.

    The operating system's own lock (`flock`): it is gone when the process that holds it is, however that ended.

    Args:
        path: The file; it exists while the lock is held.
    """

    def __init__(self, path: Path):
        self.path = path
        self._held: int | None = None

    def acquire(self) -> bool:
        """Take the lock; False if somebody holds it.

        Raises:
            OSError: If the disk has no such locks, or is full.
        """
        while True:
            opened = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(opened)
                return False
            except OSError as error:
                os.close(opened)
                raise OSError(error.errno, f"cannot lock: {error.strerror}", str(self.path)) from error
            if self._is_there(opened):
                self._held = opened
                self._sign(opened)
                return True
            # Its last owner removed the file between our opening and locking it: this lock would bind nobody.
            os.close(opened)

    def release(self) -> None:
        """Let go of the lock, and leave no file."""
        if self._held is not None:
            self.path.unlink(missing_ok=True)
            os.close(self._held)
            self._held = None

    def _sign(self, opened: int) -> None:
        """Say who holds the lock, for people who look."""
        try:
            os.truncate(opened, 0)
            os.write(opened, f"{socket.gethostname()} {os.getpid()}\n".encode())
        except OSError as error:
            self.release()
            raise OSError(error.errno, error.strerror, str(self.path)) from error

    def _is_there(self, opened: int) -> bool:
        try:
            return os.path.samestat(os.fstat(opened), os.stat(self.path))
        except FileNotFoundError:
            return False


@contextmanager
def alone_with(folder: Path, otherwise: str) -> Iterator[None]:
    """While this is open no other process that asks likewise writes the folder, whose parents it makes.

    The lock lies beside the folder, under its name and `.lock`.

    Args:
        folder: The folder, which need not exist.
        otherwise: What to tell whoever comes second.

    Raises:
        BlockingIOError: If another process has it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    lock = Lock(folder.with_name(folder.name + ".lock"))
    if not lock.acquire():
        raise BlockingIOError(otherwise)
    try:
        yield
    finally:
        lock.release()
