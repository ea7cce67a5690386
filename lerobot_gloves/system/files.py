"""Files and folders written whole, so that nothing that kills a process leaves half of one under its name."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to, a file or a folder of files; when the block ends, it is moved there.

    Contents reach the disk before the name does: after a power cut the new file is there, or what was there before. The
    path to write to is hidden, ends in `.part` whatever the file is, and is this process's own. An error, an interrupt
    included, removes what was written.

    Args:
        path: What shall appear, in a folder that exists. A file there is replaced; a folder, only if it is empty.

    Raises:
        OSError: If it cannot be written; names `path`.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        _remove(part)  # of a process of the same number that was killed
        yield part
        for one in (*part.rglob("*"), part):
            _sync(one)
        part.replace(path)
        _sync(path.parent)
    except BaseException as error:
        _remove(part)
        # The error of another file, which the block has read, stays as it is.
        if isinstance(error, OSError) and (error.filename is None or str(error.filename).startswith(str(part))):
            if error.errno is None:
                raise OSError(f"cannot write {path}: {error}") from error
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def write_text(file: Path, text: str) -> None:
    """Write a text file whole, and the folder that it is to lie in.

    Raises:
        ValueError: If it cannot be written: whoever named the file can name another.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as written:
            written.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(f"cannot write {file}: {error.strerror}") from error


def _remove(part: Path) -> None:
    if part.is_dir():
        shutil.rmtree(part, ignore_errors=True)
    else:
        part.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Wait until the disk holds a file, or the names in a folder."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    except OSError as error:
        if error.errno != errno.EINVAL:  # the answer of a disk that has nothing to do for a folder
            raise
    finally:
        os.close(opened)
