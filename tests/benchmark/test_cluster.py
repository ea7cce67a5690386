"""Ray: two machines' worth of it on this one."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from lerobot_gloves.benchmark.folder import read_rows
from tests.benchmark.conftest import QUICK
from tests.benchmark.test_bench import gloves, without_times


def start(*arguments: str) -> subprocess.Popen:
    """The command as a child of this process, whose descendants are counted."""
    return subprocess.Popen(
        [sys.executable, "-c", "from lerobot_gloves.commands import main; main()", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def descendants() -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)


@pytest.fixture(autouse=True)
def as_important_as_other_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's workers are nice by default, and get nothing of a machine whose other cores run other tests."""
    monkeypatch.setenv("RAY_worker_niceness", "0")


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two nodes of one core each, of which nothing is left."""
    pytest.importorskip("ray")
    before = set(descendants())
    from ray.cluster_utils import Cluster

    try:
        cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "num_gpus": 1, "include_dashboard": False}
        )
        cluster.add_node(num_cpus=1, num_gpus=1)
        cluster.wait_for_nodes()
        assert set(descendants()) - before
        yield cluster
        cluster.shutdown()
        _, alive = psutil.wait_procs(set(descendants()) - before, timeout=60)
        assert not alive
    finally:
        for process in set(descendants()) - before:
            process.kill()


def plays(process: psutil.Process) -> bool:
    """Whether it is one of Ray's that plays a cell at the moment: its title is the task's."""
    try:
        return " ".join(process.cmdline()).startswith("ray::play_there")
    except psutil.Error:
        return False


def kill_a_player() -> bool:
    """By kill -9 in the middle of a cell."""
    for process in filter(plays, descendants()):
        process.suspend()
        if plays(process):  # still
            process.kill()
            return True
        process.resume()
    return False


@pytest.mark.slow
def test_a_worker_killed_on_two_nodes_costs_nothing(
    tmp_path: Path, agent: str, adapter: str, cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative paths of checkpoints and all; rows are those of one local process."""
    monkeypatch.chdir(Path(agent).parent)
    options = [*QUICK, f"--agent={Path(agent).name}", f"--adapter={adapter}"]
    matrix = ["--perturbations=[noised]", '--methods=[none, "feeg+gate"]', f"--seeds={list(range(4))}"]
    ray = ["--executor=ray", f"--address={cluster.address}", "--num_workers=2", "--num_gpus=0.5"]
    process = start("bench", *options, *matrix, *ray, f"--output_dir={tmp_path / 'rows'}")
    nodes: set[int] = set()
    while process.poll() is None and len(nodes) < 2:
        nodes |= {player.ppid() for player in descendants() if plays(player)}
        time.sleep(0.05)
    assert len(nodes) == 2, "both play"
    while process.poll() is None and not kill_a_player():
        time.sleep(0.05)
    printed, errors = process.communicate(timeout=500)
    assert process.returncode == 0, errors
    assert "its worker is gone (WorkerCrashedError); it is played again" in errors
    assert printed.startswith("## ")
    rows = read_rows(tmp_path / "rows")
    assert len(rows) == 8
    assert gloves(monkeypatch, "bench", *options, *matrix, f"--output_dir={tmp_path / 'local'}") == ""
    assert without_times(rows) == without_times(read_rows(tmp_path / "local"))


@pytest.mark.slow
def test_without_an_address_ray_is_started_here_and_ended(
    tmp_path: Path, agent: str, adapter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    options = [*QUICK, f"--agent={agent}", f"--adapter={adapter}", "--seeds=[0]", '--methods=["feeg+gate"]']
    before = set(descendants())
    process = start("bench", *options, "--executor=ray", f"--output_dir={tmp_path / 'rows'}")
    printed, errors = process.communicate(timeout=500)
    assert process.returncode == 0, errors
    assert printed.startswith("## ")
    assert set(descendants()) <= before
    rows = read_rows(tmp_path / "rows")
    assert len(rows) == 1
    assert gloves(monkeypatch, "bench", *options, f"--output_dir={tmp_path / 'local'}") == ""
    assert without_times(rows) == without_times(read_rows(tmp_path / "local"))


def test_nobody_at_an_address(tmp_path: Path, agent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    ray = ["--executor=ray", "--address=127.0.0.1:1", f"--output_dir={tmp_path / 'rows'}"]
    said = gloves(monkeypatch, "bench", *QUICK, f"--agent={agent}", *ray)
    assert said.startswith("gloves bench: there is no Ray cluster at 127.0.0.1:1: ")
    assert "\n" not in said
