import multiprocessing
import os
from pathlib import Path
from typing import Any

import pytest

from lerobot_gloves.system.locks import Lock


def hold(path: Path, pipe: Any) -> None:
    pipe.send(Lock(path).acquire())
    pipe.recv()


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    first, second = Lock(tmp_path / "lock"), Lock(tmp_path / "lock")
    assert first.acquire()
    assert not second.acquire()
    assert str(os.getpid()) in first.path.read_text()
    first.release()
    assert second.acquire()
    second.release()
    assert list(tmp_path.iterdir()) == [], "nothing stays behind"


def test_a_lock_dies_with_its_owner(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=hold, args=(tmp_path / "lock", theirs))
    process.start()
    assert ours.recv() is True
    lock = Lock(tmp_path / "lock")
    assert not lock.acquire()
    process.kill()
    process.join()
    assert (tmp_path / "lock").exists(), "a killed owner cannot tidy up"
    assert lock.acquire()


def test_a_file_removed_meanwhile_binds_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last owner lets go between our opening the file and locking it: somebody else may have made a new one."""
    import fcntl

    owner, other, ours = (Lock(tmp_path / "lock") for _ in range(3))
    assert owner.acquire()
    real, raced = fcntl.flock, []

    def flock(opened: int, operation: int) -> None:
        if not raced:
            raced.append(True)
            owner.release()
            assert other.acquire()
        real(opened, operation)

    monkeypatch.setattr(fcntl, "flock", flock)
    assert not ours.acquire()
    monkeypatch.undo()
    other.release()
    assert ours.acquire()


def test_a_disk_without_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", flock)
    with pytest.raises(OSError, match=r"cannot lock: Operation not supported: '.*/lock'"):
        Lock(tmp_path / "lock").acquire()
