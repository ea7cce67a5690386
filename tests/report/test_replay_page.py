"""The page of a log: what is in it, and what is refused. What it does in a browser is tested where the browser is."""

import base64
import json
import re
import sys

import numpy as np
import pytest
import torch
from lerobot.utils.io_utils import write_video

from lerobot_gloves.commands import main
from tests.builders import load, observation, save_policy, wrap

LINE = {"length": 4, "score": 0.5, "p_value": 0.25, "edited": True, "distance": 0.5, "milliseconds": 3.0}


def write_log(folder, *lines) -> str:
    (folder / "log.jsonl").write_text("".join(f"{json.dumps({**LINE, 'evaluations': 2, **line})}\n" for line in lines))
    return str(folder / "log.jsonl")


def video(file, frames: int) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_video(file, [np.full((16, 16, 3), 5 * i, np.uint8) for i in range(frames)], 10)


@pytest.fixture
def replay(monkeypatch):
    def run(*words: str) -> None:
        monkeypatch.setattr(sys, "argv", ["gloves", "replay", *words])
        main()

    return run


def data_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)[1])


def test_the_page_holds_log_and_videos_and_needs_nothing_else(replay, tmp_path, capsys):
    actions = {"proposed": [[1.0, 0.0]], "executed": [[0.5, -0.5]]}
    log = write_log(
        tmp_path,
        {"episode": 1, "step": 0, "score": float("inf"), **actions},
        {"episode": 0, "step": 3, "edited": False},
        {"episode": 0, "step": 0},
    )
    video(tmp_path / "videos" / "task_0" / "eval_episode_0.mp4", 9)
    replay(log, f"--videos={tmp_path / 'videos'}")
    page = (tmp_path / "log.html").read_text()
    found = data_of(page)
    first, second = found["episodes"]
    assert [chunk["step"] for chunk in first["chunks"]] == [0, 3] and found["fps"] == 10
    # Nine frames are eight steps and what came of the last; without a video a chunk's length says where it ends.
    assert [chunk["runs"] for chunk in first["chunks"]] == [3, 6] and (first["steps"], second["steps"]) == (9, 4)
    file = tmp_path / "videos" / "task_0" / "eval_episode_0.mp4"
    assert base64.b64decode(first["video"].partition(",")[2]) == file.read_bytes() and second["video"] is None
    assert second["ranges"] == [[0.5, 1.0], [-0.5, 0.0]] and second["chunks"][0]["score"] == float("inf")
    assert "://" not in page and "2 episodes, 3 chunks, 66.7 % edited" in capsys.readouterr().out


def test_what_a_log_is_called_is_text(replay, tmp_path):
    log = tmp_path / "<script>alert(1)<"
    log.mkdir()
    replay(write_log(log, {"episode": 0, "step": 0}), f"--output={tmp_path / 'page.html'}", "--episodes=[0]")
    (log / "log.jsonl").rename(log / "<!--<script>.jsonl")
    replay(f"--log={log / '<!--<script>.jsonl'}", f"--output={tmp_path / 'page.html'}")
    page = (tmp_path / "page.html").read_text()
    assert "<!--" not in page and data_of(page)["about"].startswith("<!--<script>.jsonl: 1 episodes")


@pytest.mark.parametrize(
    ("lines", "options", "told"),
    [
        ([{"episode": 0, "step": 0}] * 2, [], "holds step 0 of episode 0 twice"),
        ([{"episode": None, "step": 0}], [], "line 1 of"),
        ([], [], "holds no chunks"),
        ([{"episode": 0, "step": 0}], ["--episodes=[0, 7]"], "the log has no episode 7: choose from 0"),
        ([{"episode": 0, "step": 0}], ["--fps=0"], "fps is 0.0, but must be above 0"),
        ([{"episode": 0, "step": 0}], ["--videos=EMPTY"], "holds no videos"),
        ([{"episode": 5, "step": 0}], ["--videos=ONE"], "are of none of the episodes 5"),
        ([{"episode": 0, "step": 0}], ["--videos=TWO"], "are both of episode 0: name the folder of one run"),
    ],
)
def test_what_cannot_be_shown_is_told_in_one_line(replay, tmp_path, lines, options, told):
    for name, files in {"EMPTY": [], "ONE": ["a_0.mp4"], "TWO": ["a_0.mp4", "b_0.mp4"]}.items():
        (tmp_path / name).mkdir()
        for file in files:
            video(tmp_path / name / file, 2)
    log = write_log(tmp_path, *lines)
    words = [re.sub(r"=([A-Z]+)$", lambda match: f"={tmp_path / match[1]}", option) for option in options]
    with pytest.raises(SystemExit) as error:
        replay(log, *words)
    assert str(error.value).startswith("gloves replay: ") and told in str(error.value)
    assert "\n" not in str(error.value) and not (tmp_path / "log.html").exists()


def test_a_log_may_hold_what_was_proposed_and_what_was_executed(tmp_path):
    agent, adapter = (
        save_policy(tmp_path / "agent", "gloves_flow_policy"),
        save_policy(tmp_path / "a", "gloves_expert_flow"),
    )
    for actions in (True, False):
        log = tmp_path / f"{actions}.jsonl"
        policy = wrap(agent, adapter=adapter, method="feeg:start=0.3", log=log, log_actions=actions)
        batch = observation(1)
        torch.manual_seed(0)
        executed = policy.select_action(dict(batch))
        line = json.loads(log.read_text().splitlines()[0])
        assert ("proposed" in line) == ("executed" in line) == actions
        if actions:
            bare, (preprocess, postprocess) = load(agent)
            torch.manual_seed(0)
            proposed = postprocess(bare.predict_action_chunk(preprocess(dict(batch))))[0, : line["length"]]
            torch.testing.assert_close(torch.tensor(line["proposed"]), proposed)
            torch.testing.assert_close(torch.tensor(line["executed"])[0], executed[0])
            assert line["edited"] and line["proposed"] != line["executed"]
