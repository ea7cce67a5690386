"""How a process that stages episodes fails; what the others stage is no matter here."""

import errno
import os
import signal

import pytest

from lerobot_gloves.recording.workers import stage_all


def full_disk(parts):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def killed(parts):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "reason"),
    [(full_disk, r"\[Errno 28\] No space left on device"), (killed, "killed by signal 9")],
)
def test_what_a_process_failed_of_is_told_once(tmp_path, stage, reason, capfd):
    with pytest.raises(ChildProcessError, match=f"^1 of 1 recording processes failed: {reason}$"):
        list(stage_all(stage, tmp_path, [range(1)], num_workers=2))
    assert "Traceback" not in capfd.readouterr().err
