"""`gloves calibrate` reads data as the training did, and what it makes of little of it."""

import json
import logging
from pathlib import Path

import pytest
import torch
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.factory import make_dataset
from safetensors.torch import load_file, save_file

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from lerobot_gloves.commands import calibrate as command
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.generators import spawn
from tests.builders import FLOW, make_config, observation, save_policy, wrap, write_dataset

T = FLOW["chunk_size"]


@pytest.fixture
def adapter(tmp_path) -> Path:
    return save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)


@pytest.fixture
def run(typed, adapter):
    def run(*options: str) -> Calibration:
        own = ["--policy.device=cpu", "--dataset.repo_id=me/tiny", "--scores=[reverse]"]
        typed(f"--policy.path={adapter}", *own, *options)
        return command.calibrate()

    return run


@pytest.fixture
def refusal(run, adapter):
    def refusal(*options: str) -> str:
        with pytest.raises(SystemExit) as exit, one_line_errors("gloves calibrate"):
            run(*options)
        assert not (adapter / CALIBRATION_NAME).exists() and "\n" not in str(exit.value.code)
        return str(exit.value.code).removeprefix("gloves calibrate: ")

    return refusal


def said(caplog) -> str:
    """The line on what the chunks are too few for, which there is one of."""
    [line] = [r.getMessage() for r in caplog.records if r.getMessage().startswith("the smallest alpha of a gate")]
    return line


READ = ("root", "revision", "tolerance_s", "_video_backend", "_depth_output_unit")


def test_what_is_not_said_is_read_as_the_training_reads_it(run, adapter, tmp_path, monkeypatch):
    root = write_dataset(tmp_path / "data").root
    dataset = DatasetConfig("me/tiny", root=str(root), video_backend="pyav", depth_output_unit="m", episodes=[0, 1])
    training = TrainPipelineConfig(dataset=dataset, policy=make_config("gloves_expert_flow"), tolerance_s=0.02)
    training._save_pretrained(adapter)
    theirs, seen = make_dataset(training), []
    score = command.score_dataset
    monkeypatch.setattr(
        command, "score_dataset", lambda a, p, data, *rest: seen.append(data) or score(a, p, data, *rest)
    )
    monkeypatch.setattr("lerobot_gloves.checkpoints.held_out.get_safe_default_video_backend", lambda: "torchcodec")
    assert run().episodes == (2, 3)
    assert [getattr(seen[0], name) for name in READ] == [getattr(theirs, name) for name in READ]
    assert seen[0].tolerance_s == 0.02 and seen[0]._depth_output_unit == "m"
    named = ["--tolerance_s=0.5", "--dataset.depth_output_unit=mm", "--dataset.video_backend=video_reader"]
    run(*named, f"--dataset.root={root}")
    assert [getattr(seen[1], name) for name in READ[2:]] == [0.5, "video_reader", "mm"]
    training.dataset.video_backend, training.dataset.root = "torchcodec", "/gone"
    training._save_pretrained(adapter)
    monkeypatch.setattr("lerobot_gloves.checkpoints.held_out.get_safe_default_video_backend", lambda: "pyav")
    run(f"--dataset.root={root}")
    assert seen[2]._video_backend == "pyav", "this machine has no other"


def test_data_of_another_rate_is_refused(typed, run, refusal, adapter, tmp_path):
    root = write_dataset(tmp_path / "data").root
    config = json.loads((adapter / "config.json").read_text())
    assert config.pop("fps") is None
    (adapter / "config.json").write_text(json.dumps(config))
    assert run(f"--dataset.root={root}").scores, "a checkpoint of before does not say its rate"
    (adapter / CALIBRATION_NAME).unlink()
    (adapter / "config.json").write_text(json.dumps(config | {"fps": 50}))
    assert refusal(f"--dataset.root={root}") == (
        "the adapter was trained on 50 frames a second, but me/tiny has 20: take one of the same rate, or, if that "
        "figure is wrong, --policy.fps=null"
    )
    assert run(f"--dataset.root={root}", "--policy.fps=null").scores


def test_episodes_as_long_as_a_chunk_are_scored_and_shorter_ones_are_told(run, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    root = write_dataset(tmp_path / "data", episodes=5, length=[T - 1, T, T - 1, T, T]).root
    calibration = run(f"--dataset.root={root}", "--stride=4")
    assert calibration.episode_of == (1, 3, 4) and calibration.scores["reverse:steps=1"].shape == (T, 3)
    # One over four of both, since each has one chunk.
    line = "the smallest alpha of a gate: 0.25 of chunks, 0.25 of episodes (alpha_of=episodes); "
    short = f"of joined scores times their number; 2 episodes are shorter than {T} actions and not among them"
    assert said(caplog) == line + short
    assert len(set(run(f"--dataset.root={root}", f"--lengths=[{T - 1}]").episode_of)) == 5


def test_where_all_episodes_are_shorter_than_a_chunk_what_they_have_is_judged(run, refusal, adapter, tmp_path, caplog):
    root = write_dataset(tmp_path / "data", episodes=19, length=3).root
    line = refusal(f"--dataset.root={root}", "--lengths=[1, 4]")
    assert line == "lengths holds 4, but the longest episode has 3 actions"
    assert refusal(f"--dataset.root={root}", "--lengths=[0]").startswith("lengths is [0], but must hold numbers of")
    assert run(f"--dataset.root={root}").lengths == (1, 2, 3)
    corrector = wrap(save_policy(tmp_path / "agent", "act"), adapter=adapter, gate=True, alpha=0.05)._corrector
    proposal = 0.004 * torch.randn(2, T, 2, generator=torch.Generator().manual_seed(0))
    whole, short = (corrector(observation(2), proposal[:, :n], spawn(0, 2, stream="editor")) for n in (T, 3))
    torch.testing.assert_close(whole.score, short.score)


def test_twelve_scores_are_told_to_be_too_few_and_the_gate_agrees(run, adapter, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    run(f"--dataset.root={write_dataset(tmp_path / 'data', episodes=3, length=T + 3).root}", "--stride=1")
    # 1/13 rounded up, and 1/4.
    assert said(caplog).startswith(
        "the smallest alpha of a gate: 0.077 of chunks, 0.25 of episodes (alpha_of=episodes)"
    )
    agent = save_policy(tmp_path / "agent", "act")
    wrap(agent, adapter=adapter, gate=True, alpha=0.077)
    wrap(agent, adapter=adapter, gate=True, alpha=0.25, alpha_of="episodes")
    with pytest.raises(ValueError, match="with 12 calibration chunks nothing can be that unlikely"):
        wrap(agent, adapter=adapter, gate=True, alpha=0.0769)


def test_infinite_scores_are_told_by_their_number(run, adapter, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    tables = {"one": torch.tensor([[1.0, torch.inf, 2.0, torch.inf]]), "two": torch.arange(4.0)[None]}
    about = {"repo_id": "me/x", "revision": "v3.0", "episodes": (0, 1), "weights": "", "episode_of": (0, 0, 1, 1)}
    calibration = Calibration(scores=tables, **about)
    # Two of four above all others leave the third of five ranks; of the episodes both are infinite by their worst.
    assert [calibration.smallest_alpha(name) for name in tables] == [0.6, 0.2]
    assert [calibration.smallest_alpha(name, by_episode=True) for name in tables] == [1.0, 1 / 3]


def test_scores_that_are_no_numbers_are_refused(refusal, adapter, tmp_path):
    path = adapter / "model.safetensors"
    weights = load_file(path)
    weights["ema.module.dit.head.bias"][0] = torch.nan
    save_file(weights, path)
    line = refusal(f"--dataset.root={write_dataset(tmp_path / 'data', episodes=2, length=T).root}")
    assert line.startswith("2 of 2 chunks score NaN by reverse:steps=1, the first of episode 0: the adapter's weights")


def test_what_never_changed_in_training_has_no_say_in_the_calibration(run, adapter, tmp_path):
    """As in the wrapper, which scores the same chunk under the same observation alike."""
    root = write_dataset(tmp_path / "data", episodes=2, length=T).root
    path = next(adapter.glob("policy_preprocessor_step_*normalizer*.safetensors"))
    statistics = load_file(path)
    for name in ("min", "max"):  # in this data they are 0 to 11
        statistics[f"observation.environment_state.{name}"] = torch.arange(12.0) + 0.5
    save_file(statistics, path)
    scores = run(f"--dataset.root={root}").scores["reverse:steps=1"]
    log = tmp_path / "log.jsonl"
    corrector = wrap(save_policy(tmp_path / "agent", "act"), adapter=adapter, method="none", log=log)._corrector
    rows = LeRobotDataset("me/tiny", root=root).hf_dataset
    seen = {key: rows[0][key][None] for key in rows.features if key.startswith("observation.")}
    chunk = torch.stack([rows[i]["action"] for i in range(T)])[None]
    found = corrector(seen, chunk, spawn(0, 1, stream="editor")).score
    torch.testing.assert_close(scores[T - 1, :1], found, rtol=1e-4, atol=1e-5)


def test_training_writes_down_the_rate(tmp_path):
    from lerobot.policies import make_policy

    meta = LeRobotDatasetMetadata("me/tiny", root=write_dataset(tmp_path / "data", episodes=1).root)
    for kind in ("gloves_expert_flow", "gloves_align_flow", "gloves_copilot", "gloves_flow_policy"):
        options = {"sources": ["expert"]} if kind == "gloves_align_flow" else {}
        assert make_policy(make_config(kind, **options), ds_meta=meta).config.fps == 20
