import os
import re
import signal
import subprocess
import sys
import time

import pytest

from lerobot_gloves.system.processes import Command, clock, console_script, run

COUNTED = re.compile(r"at (?P<done>\d+)/(?P<total>\d+)")


def command(folder, label, program):
    return Command(label, [sys.executable, "-c", program], folder / f"{label}.log", COUNTED)


def meet(folder, name, other):
    """A program that ends a second after the other one has begun."""
    return f"""
import time
from pathlib import Path
Path({str(folder / name)!r}).touch()
deadline = time.time() + 120
while not Path({str(folder / other)!r}).exists():
    assert time.time() < deadline, "the other does not run beside this one"
    time.sleep(0.05)
time.sleep(1)
Path({str(folder / name)!r}).rename({str(folder / f"{name} is over")!r})
"""


def test_two_run_side_by_side_and_the_third_waits(tmp_path, capsys):
    waits = f"from pathlib import Path; assert list(Path({str(tmp_path)!r}).glob('* is over')), 'all three run'"
    commands = [meet(tmp_path, "first", "second"), meet(tmp_path, "second", "first"), waits]
    run(
        [command(tmp_path, name, program) for name, program in zip("abc", commands, strict=True)],
        began=time.monotonic(),
    )
    lines = capsys.readouterr().out.splitlines()
    assert sorted(re.sub(r"\d+:\d\d", "TIME", line) for line in lines) == [f"[TIME] {name}: TIME" for name in "abc"]


def test_a_failure_ends_the_others_and_shows_its_last_lines(tmp_path, capfd):
    lasting = command(tmp_path, "lasting", "import time; time.sleep(60)")
    failing = command(
        tmp_path, "failing", "print(*range(30), sep='\\n', flush=True); raise ValueError('no such corridor')"
    )
    before = time.monotonic()
    with pytest.raises(
        ChildProcessError, match=r"failing failed with exit status 1; all it printed is in .*failing\.log"
    ):
        run([lasting, failing], began=before)
    assert time.monotonic() - before < 30
    errors = capfd.readouterr().err
    assert "ValueError: no such corridor" in errors and "29" in errors and "\n5\n" not in errors
    assert "KeyboardInterrupt" in (tmp_path / "lasting.log").read_text()


def test_children_take_one_thread_and_leave_the_hub_alone(tmp_path):
    run(
        [command(tmp_path, "a", "import os; print(os.environ['OMP_NUM_THREADS'], os.environ['HF_HUB_OFFLINE'])")],
        began=0,
    )
    assert (tmp_path / "a.log").read_text() == "1 1\n"


def test_progress_is_shown_where_there_is_a_terminal(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    program = "import time; print('at 3/300\\rat 17/300', flush=True); time.sleep(3)"
    run([command(tmp_path, "raw agent", program)], began=time.monotonic())
    assert "raw agent: 17 of 300" in capsys.readouterr().out


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process that its parent died")
def test_children_end_with_a_killed_parent(tmp_path):
    child = f"import os, time; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    parent = f"""
import re, signal, sys
from pathlib import Path
from lerobot_gloves.system.processes import Command, run
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as for a command in the background
run([Command("child", [sys.executable, "-c", {child!r}], Path({str(tmp_path / "log")!r}), re.compile("x"))], began=0)
"""
    process = subprocess.Popen([sys.executable, "-c", parent])
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        assert process.poll() is None
        time.sleep(0.05)
    pid = int((tmp_path / "pid").read_text())
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    deadline = time.monotonic() + 20
    while True:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            break
        state = (tmp_path.__class__("/proc") / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()[0]
        if state == "Z":
            break
        assert time.monotonic() < deadline, "the child outlived its parent"
        time.sleep(0.05)


def test_console_scripts_are_this_environments():
    assert os.access(console_script("lerobot-eval"), os.X_OK)
    with pytest.raises(FileNotFoundError, match="no-such-command is not installed beside"):
        console_script("no-such-command")


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0:00"), (65, "1:05"), (3599.9, "59:59"), (3600, "60:00")])
def test_clock(seconds, text):
    assert clock(seconds) == text
