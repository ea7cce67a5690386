import errno
import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from lerobot_gloves.system import files
from lerobot_gloves.system.files import whole


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_the_block_ends(tmp_path: Path) -> None:
    target = tmp_path / "row.json"
    with whole(target) as part:
        part.write_text("new")
        assert not target.exists()
    assert target.read_text() == "new"
    with whole(target) as part:
        part.write_text("newer")
        assert target.read_text() == "new"
    assert target.read_text() == "newer" and names(tmp_path) == ["row.json"]


def test_a_folder_appears_with_all_its_files(tmp_path: Path) -> None:
    with whole(tmp_path / "agent") as part:
        (part / "inner").mkdir(parents=True)
        (part / "inner" / "weights").write_bytes(b"1")
        assert not (tmp_path / "agent").exists()
    assert (tmp_path / "agent" / "inner" / "weights").read_bytes() == b"1" and names(tmp_path) == ["agent"]


def test_a_folder_replaces_no_other(tmp_path: Path) -> None:
    (tmp_path / "agent").mkdir()
    (tmp_path / "agent" / "mine").touch()
    with pytest.raises(OSError, match=r"not empty: '.*/agent'$"), whole(tmp_path / "agent") as part:
        part.mkdir()
    assert names(tmp_path) == ["agent"] and names(tmp_path / "agent") == ["mine"]


@pytest.mark.parametrize("error", [ValueError("no such score"), KeyboardInterrupt()])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_an_error_leaves_what_was_there_and_nothing_else(tmp_path: Path, error: BaseException, kind: str) -> None:
    target = tmp_path / "row.json"
    target.write_text("old")

    def fail() -> None:
        with whole(target) as part:
            if kind == "folder":
                part.mkdir()
            (part / "file" if kind == "folder" else part).write_text("half")
            raise error

    with pytest.raises(type(error)) as raised:
        fail()
    assert raised.value is error
    assert target.read_text() == "old" and names(tmp_path) == ["row.json"]


@pytest.mark.parametrize("glob", ["*.json", "*.npz", "*.safetensors", "episode_*", "*.lock", "*.yaml"])
def test_what_is_half_written_is_no_file_of_that_kind(tmp_path: Path, glob: str) -> None:
    with whole(tmp_path / glob.replace("*", "x")) as part:
        part.touch()
        assert not list(tmp_path.glob(glob))
    assert len(list(tmp_path.glob(glob))) == 1


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_an_error_of_the_disk_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def fsync(opened: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files.os, "fsync", fsync)
    with pytest.raises(OSError) as raised, whole(tmp_path / "row.json") as part:
        part.write_text("new")
    assert str(raised.value) == f"[Errno {number}] {os.strerror(number)}: '{tmp_path / 'row.json'}'"
    assert names(tmp_path) == []


def test_a_library_that_does_not_know_the_number_of_its_error_names_the_file_too(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"^cannot write .*/row.json: the disk is full$"), whole(tmp_path / "row.json"):
        raise OSError("the disk is full")


def test_a_missing_folder_is_named_by_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*/gone/row.json'"),
        whole(tmp_path / "gone" / "row.json") as part,
    ):
        part.write_text("new")


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"'.*/source'"), whole(tmp_path / "row.json") as part:
        part.write_bytes((tmp_path / "source").read_bytes())
    assert names(tmp_path) == []


def test_contents_and_names_are_on_the_disk_in_that_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target, synced = tmp_path / "agent", []

    def fsync(opened: int) -> None:
        synced.append((Path(os.readlink(f"/proc/self/fd/{opened}")), target.exists()))

    monkeypatch.setattr(files.os, "fsync", fsync)
    with whole(target) as part:
        part.mkdir()
        (part / "weights").touch()
    assert synced == [(part / "weights", False), (part, False), (tmp_path, True)]


def test_a_disk_that_cannot_sync_folders_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(opened: int) -> None:
        if Path(os.readlink(f"/proc/self/fd/{opened}")).is_dir():
            raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(files.os, "fsync", fsync)
    with whole(tmp_path / "row.json") as part:
        part.write_text("new")
    assert (tmp_path / "row.json").read_text() == "new"


def write(target: Path, text: str, pipe: Any) -> None:
    """Write half, say so, and write the rest when told to."""
    with whole(target) as part, part.open("w") as file:
        file.write(text[: len(text) // 2])
        file.flush()
        pipe.send(part)
        pipe.recv()
        file.write(text[len(text) // 2 :])


def started(target: Path, text: str) -> tuple[Any, Any, Path]:
    """Another process that has written half: it, the pipe to it, and where it writes."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=write, args=(target, text, theirs))
    process.start()
    return process, ours, ours.recv()


def test_a_process_killed_halfway_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "row.json"
    target.write_text("old")
    process, _, part = started(target, "new and long")
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert target.read_text() == "old" and part.read_text() == "new an"
    with whole(target) as ours:
        ours.write_text("new")
    assert target.read_text() == "new"


def test_two_processes_at_once_each_write_the_whole_file(tmp_path: Path) -> None:
    target = tmp_path / "row.json"
    first, second = started(target, "first " * 1000), started(target, "second " * 1000)
    assert first[2] != second[2] and not target.exists()
    for (process, pipe, _), text in ((second, "second "), (first, "first ")):
        pipe.send("go on")
        process.join()
        assert process.exitcode == 0 and target.read_text() == text * 1000
    assert names(tmp_path) == ["row.json"]


def test_what_a_killed_process_of_the_same_number_left_is_no_part_of_the_new(tmp_path: Path) -> None:
    left = tmp_path / f".agent.{os.getpid()}.part"
    left.mkdir()
    (left / "stale").touch()
    with whole(tmp_path / "agent") as part:
        part.mkdir()
        (part / "weights").touch()
    assert names(tmp_path) == ["agent"] and names(tmp_path / "agent") == ["weights"]
