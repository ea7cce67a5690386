"""`gloves check` with an agent, by itself or by its log, and what it says on a model card."""

import json
import re
from html import unescape

import pytest
import torch
from huggingface_hub import HfApi
from lerobot.configs import PreTrainedConfig
from torch.utils.data import DataLoader

from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.logged import of_one_length, read_log
from lerobot_gloves.checkpoints.on_data import open_adapter
from lerobot_gloves.checkpoints.telling import AGENT, BESIDE, CLEAN, tell
from lerobot_gloves.commands.calibrate import calibrate
from lerobot_gloves.commands.check import main
from lerobot_gloves.recording.asked import asked
from lerobot_gloves.scores import ReverseScore
from tests.builders import ACT, FLOW, load, save_policy, write_dataset

T = FLOW["chunk_size"]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=3, length=9)


@pytest.fixture(scope="module")
def adapter(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("saved") / "adapter", "gloves_expert_flow", seed=7)


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("saved") / "agent", "act", seed=3)


def options(folder, data, *more: str) -> list[str]:
    return [f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={data.root}", *more]


def refusal() -> str:
    with pytest.raises(SystemExit) as exit:
        main()
    return str(exit.value.code)


def opened(adapter, data):
    config = PreTrainedConfig.from_pretrained(adapter)
    config.pretrained_path, config.device = adapter, "cpu"
    return open_adapter(config, HeldOutConfig("me/tiny", root=str(data.root)), None)


def test_short_proposals_stand_beside_as_many_of_the_experts_actions(adapter, data, typed):
    """An agent that proposes two of the expert's actions scores what a calibration of two actions has."""
    found = tell(opened(adapter, data), {"reverse": ReverseScore()}, 1000, 8, agent=lambda row: row["action"][:, :2])
    scores = found.scores["reverse"]
    assert found.proposed == 2 and torch.equal(scores[AGENT], scores[BESIDE])
    assert not torch.equal(scores[AGENT], scores[CLEAN])
    typed(*options(adapter, data, "--stride=1", "--scores=[reverse]"))
    expected = calibrate().of("reverse:steps=1", 2)
    torch.testing.assert_close(scores[AGENT].sort().values.float(), expected.sort().values)


def test_an_agent_is_asked_for_all_that_it_would_do(agent, data):
    frames = next(iter(DataLoader(data, batch_size=5)))
    policy, (before, behind) = load(agent)
    shown = {key: frames[key] for key in policy.config.input_features}
    expected = behind(policy.predict_action_chunk(before(dict(shown))))
    propose = asked(str(agent), data.meta, "cpu")
    for _ in range(2):
        found = propose(frames)
        assert found.shape == (5, ACT["chunk_size"], 2)
        torch.testing.assert_close(found, expected)


def test_it_stands_in_the_report_and_on_the_page(adapter, agent, data, typed, capsys, tmp_path):
    page = tmp_path / "deep" / "check.html"
    typed(*options(adapter, data, f"--agent={agent}", f"--html={page}", "--scores=[reverse]"))
    with pytest.raises(SystemExit):
        main()
    printed = capsys.readouterr().out
    assert f"Proposals of {agent} beside the expert's chunks of as many actions ({T})" in printed
    assert re.search(r"\| reverse:steps=1 \| agent +\| \d\.\d\d \|", printed)
    shown = unescape(page.read_text())
    assert "your agent's" in shown and printed.strip().splitlines()[-1] in shown


def test_a_log_is_read_by_the_length_that_most_have(tmp_path):
    file = tmp_path / "chunks.jsonl"
    scores = [(9, 1.0), (2, 5.0), (6, float("inf"))]
    lines = [{"length": length, "scores": {"reverse": score, "residual": 0.5}} for length, score in scores]
    file.write_text("\n".join(json.dumps(line).replace("Infinity", "1e999") for line in lines))
    found = of_one_length(read_log(file), T)
    assert (found.length, found.others) == (T, 1)
    assert {name: score.tolist() for name, score in found.scores.items()} == {
        "reverse": [1.0, float("inf")],
        "residual": [0.5, 0.5],
    }


def test_a_logs_scores_are_judged_by_the_experts(adapter, data, typed, capsys, tmp_path):
    file = tmp_path / "chunks.jsonl"
    lines = [{"length": 2, "scores": {"reverse:steps=1": 1e9 * one}} for one in (0, 1, 1, 1)]
    file.write_text("\n".join(map(json.dumps, lines)))
    typed(*options(adapter, data, f"--log={file}", "--scores=[reverse]"))
    with pytest.raises(SystemExit):
        main()
    printed = capsys.readouterr().out
    assert f"Proposals of {file} (4) beside the expert's chunks of as many actions (2)" in printed
    assert re.search(r"\| reverse:steps=1 \| agent +\| 0\.75 \| 0 % +\| 0 % +\| 75 % ", printed)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--agent=a", "--log=b"], "agent and log are both given: name one of them"),
        (["--log=nowhere"], "nowhere is no file: --log takes what --policy.log wrote"),
        (["--html={folder}"], "{folder} is a folder: --html takes the file to write"),
        (["--agent=nowhere"], "--agent=nowhere is no checkpoint's folder, nor one on the Hub in reach"),
        (["--log={log}"], "{log} has no reverse:steps=1, reverse:steps=5, but residual: name these by --scores"),
        (["--log={unscored}"], "{unscored} holds no scores: --policy.score=reverse:steps=5 and --policy.method=none"),
        (["--log={text}"], "line 1 of {text} is none that --policy.log writes"),
    ],
)
def test_bad_input_gets_one_line_before_anything_is_scored(adapter, data, typed, capsys, tmp_path, more, said):
    (tmp_path / "log").write_text('{"length": 2, "scores": {"residual": 1.0}}')
    (tmp_path / "unscored").write_text('{"length": 2}')
    (tmp_path / "text").write_text("success")
    names = {"folder": tmp_path} | {name: tmp_path / name for name in ("log", "unscored", "text")}
    typed(*options(adapter, data, *(one.format(**names) for one in more)))
    assert refusal().startswith(f"gloves check: {said.format(**names)}")
    assert "smallest alpha" not in capsys.readouterr().out


def test_an_agent_of_other_observations_is_refused(adapter, data, typed, tmp_path):
    pixels = save_policy(tmp_path / "pixels", "act", "pixels")
    typed(*options(adapter, data, f"--agent={pixels}"))
    assert refusal().startswith("gloves check: the agent needs observation.images.front")


def test_the_card_says_what_was_found_until_the_weights_are_others(adapter, data, typed, online, tmp_path):
    HfApi().create_repo("tester/adapter")
    HfApi().upload_folder(repo_id="tester/adapter", folder_path=adapter)
    own = ["--dataset.repo_id=me/tiny", f"--dataset.root={data.root}", "--scores=[reverse]", "--policy.device=cpu"]

    def card() -> str:
        return online.repositories["models", "tester/adapter"].files["README.md"].decode()

    typed("--policy.path=tester/adapter", *own, "--push_to_hub=true")
    with pytest.raises(SystemExit):
        main()
    assert re.search(
        r"## Checked\n\nOn \d+ chunks of 3 episodes of `me/tiny`: not usable: .*\| noised", card(), re.DOTALL
    )
    calibrate()
    assert "| noised" in card() and card().count("## Checked") == 1, "calibrate knows less"
    assert "| calibration | `reverse:steps=1`" in card()
    HfApi().upload_folder(repo_id="tester/adapter", folder_path=save_policy(tmp_path / "other", "gloves_expert_flow"))
    calibrate()
    assert "## Checked\n\nnot usable: " in card() and "| noised" not in card()
