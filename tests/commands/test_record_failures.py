"""Recordings that are killed, interrupted, or run into a full disk or a Hub that does not answer."""

import errno
import os
import signal
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from huggingface_hub.errors import HfHubHTTPError, LocalTokenNotFoundError
from lerobot.datasets import LeRobotDataset

from lerobot_gloves.commands.record import main, record
from lerobot_gloves.recording import staging
from tests.builders import save_policy
from tests.commands.test_record import config, typed_to_record
from tests.preloaded import Started

KEPT = "what is recorded is kept: run the command again to go on"


@pytest.fixture
def last_line(typed):
    """Runs the command in this process; returns the line that it ends with."""

    def last_line(root: Path, *options: str) -> str:
        named = ["--env.type=gloves_slalom", "--dataset.repo_id=me/slalom", f"--dataset.root={root}"]
        typed(*named, "--dataset.num_episodes=2", *options)
        with pytest.raises(SystemExit) as exit:
            main()
        command, _, line = str(exit.value.code).partition(": ")
        assert command == "gloves record" and "\n" not in line
        return line

    return last_line


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path, last_line, monkeypatch):
    root = tmp_path / "slalom"
    folder = staging.staging_folder(root)
    save = np.savez_compressed

    def on_a_full_disk(archive, **arrays):
        if "episode_000001" not in archive.name:
            return save(archive, **arrays)
        with open("/dev/full", "wb") as full:
            save(full, **arrays)

    monkeypatch.setattr(np, "savez_compressed", on_a_full_disk)
    assert last_line(root) == f"[Errno 28] No space left on device: '{folder / 'episode_000001.npz'}'; {KEPT}"
    assert {file.name for file in folder.iterdir()} == {"settings.json", "episode_000000.npz"} and not root.exists()
    monkeypatch.undo()
    record(config(root))
    assert LeRobotDataset("me/slalom", root=root).num_episodes == 2


def test_a_full_disk_while_the_dataset_is_assembled_keeps_what_is_staged(tmp_path, last_line, monkeypatch):
    root = tmp_path / "slalom"
    save = LeRobotDataset.save_episode

    def full(self, *args, **kwargs):
        if self.num_episodes == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return save(self, *args, **kwargs)

    monkeypatch.setattr(LeRobotDataset, "save_episode", full)
    assert last_line(root) == f"could not write {root}: [Errno 28] No space left on device; {KEPT}"
    assert staging.staged(staging.staging_folder(root)) == {0, 1} and not root.exists()
    monkeypatch.undo()
    monkeypatch.setattr("lerobot_gloves.recording.staging.save", None)  # nobody plays again
    record(config(root))
    assert LeRobotDataset("me/slalom", root=root).num_episodes == 2


def test_a_failed_upload_is_one_line_and_is_all_that_is_left_to_do(tmp_path, last_line, monkeypatch):
    root = tmp_path / "slalom"
    said = last_line(root, "--dataset.push_to_hub=true")  # the tests are offline
    assert said.startswith(f"{root} is complete, but the Hub has not got it: ") and "offline" in said.lower()
    monkeypatch.setattr("lerobot_gloves.recording.demonstrations.record", None)  # nobody records again
    request = httpx.Request("POST", "https://hub/api/repos/create")
    unauthorized = "401 Client Error.\n\nInvalid username or password."
    for error, reason in (
        (HfHubHTTPError(unauthorized, response=httpx.Response(401, request=request)), "401 Client Error. Invalid"),
        (LocalTokenNotFoundError("Token is required"), "Token is required"),
        (httpx.ConnectError("[Errno 111] Connection refused"), "[Errno 111] Connection refused"),
    ):

        def create_repo(*_, error=error, **__):
            raise error

        monkeypatch.setattr("huggingface_hub.HfApi.create_repo", create_repo)
        said = last_line(root, "--dataset.push_to_hub=true")
        assert f"the Hub has not got it: {reason}" in said and "hf auth login" in said and said.endswith(f"; {KEPT}")
        assert staging.staged(staging.staging_folder(root)) == {0, 1}
    assert LeRobotDataset("me/slalom", root=root).num_episodes == 2


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_keeps_what_is_recorded(tmp_path):
    root = tmp_path / "slalom"
    folder = staging.staging_folder(root)
    process = start(root, 300, "--num_workers=2")
    while len(staging.staged(folder)) < 3 and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers as well
    printed, errors = process.communicate(timeout=120)  # returns when the last worker has let go of the pipes
    assert process.returncode == 1
    assert errors.splitlines()[-1] == f"gloves record: interrupted; {KEPT}"
    assert "Traceback" not in printed + errors
    assert 3 <= len(staging.staged(folder)) < 300 and not root.exists()


def start(root: Path, num_episodes: int, *options: str) -> Started:
    return Started("gloves", *typed_to_record(root, num_episodes, *options))


def kill_when(process: Started, reached) -> None:
    while not reached():
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_a_recording_killed_while_it_plays_and_while_it_assembles_is_finished_by_the_same_command(tmp_path):
    root = tmp_path / "slalom"
    folder = staging.staging_folder(root)
    kill_when(start(root, 12), lambda: len(staging.staged(folder)) >= 3)
    kept = {file: file.stat().st_mtime_ns for file in folder.glob("episode_*.npz")}
    assert 3 <= len(kept) < 12 and not root.exists()
    kill_when(start(root, 12), lambda: (folder / "dataset" / "data").exists())
    assert not root.exists()
    assert all(file.stat().st_mtime_ns == written for file, written in kept.items())  # none was played again
    process = start(root, 12)
    output = process.communicate()
    assert process.returncode == 0, output
    recorded = LeRobotDataset("me/slalom", root=root)
    assert recorded.num_episodes == 12 and not folder.exists()
    lengths = np.bincount(np.array(recorded.hf_dataset["episode_index"]).ravel())
    assert len(lengths) == 12 and lengths.min() > 80


@pytest.mark.slow
def test_an_agents_recording_killed_while_it_plays_ends_as_if_it_had_not_been(tmp_path):
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy")
    options = [f"--agent={agent}", "--perturbation=laggy", "--batch_size=2", "--env.episode_length=60"]
    root = tmp_path / "killed"
    folder = staging.staging_folder(root)
    kill_when(start(root, 12, *options), lambda: len(staging.staged(folder)) >= 4)
    kept = {file: file.stat().st_mtime_ns for file in folder.glob("episode_*.npz")}
    assert 4 <= len(kept) < 12 and not root.exists()
    for name in ("killed", "whole"):
        process = start(tmp_path / name, 12, *options)
        output = process.communicate()
        assert process.returncode == 0, output
    killed, whole = (LeRobotDataset("me/slalom", root=tmp_path / name) for name in ("killed", "whole"))
    assert killed.num_episodes == 12
    assert np.array_equal(np.stack(killed.hf_dataset["action"]), np.stack(whole.hf_dataset["action"]))
