import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import LeRobotDataset

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from lerobot_gloves.commands.calibrate import calibrate, main
from lerobot_gloves.generators import spawn
from lerobot_gloves.scores import SCORES, ReverseScore
from tests.builders import FLOW, load, make_config, save_policy, wrap, write_dataset

T = FLOW["chunk_size"]
EPISODES, LENGTH = 8, 9


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=EPISODES, length=LENGTH).root


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    return save_policy(tmp_path_factory.mktemp("saved") / "adapter", "gloves_expert_flow", seed=7)


@pytest.fixture
def adapter(saved, tmp_path) -> Path:
    """As `save_pretrained` leaves it: it does not say what it was trained on."""
    return shutil.copytree(saved, tmp_path / "adapter")


def trained(adapter: Path, repo_id: str = "me/tiny", **options) -> None:
    """Have the checkpoint say that it was trained on a dataset, the last quarter of the episodes held out."""
    dataset = DatasetConfig(**{"repo_id": repo_id, "root": "/gone", "eval_split": 0.25} | options)
    TrainPipelineConfig(dataset=dataset, policy=make_config("gloves_expert_flow"))._save_pretrained(adapter)


def warnings(caplog) -> list[str]:
    """Ours; LeRobot has a page to say of torchcodec."""
    return [r.message for r in caplog.records if r.module == "held_out" and r.levelname == "WARNING"]


@pytest.fixture
def run(typed, data, adapter):
    """Runs the command on the adapter and the dataset; returns the calibration that it has written."""

    def run(*options: str) -> Calibration:
        typed(*common(adapter, data), *options)
        calibrate()
        return Calibration.load(adapter)

    return run


def common(adapter: Path, data: Path) -> list[str]:
    own = ["--dataset.repo_id=me/tiny", f"--dataset.root={data}", "--stride=1", "--scores=[reverse]"]
    return [f"--policy.path={adapter}", "--policy.device=cpu", *own]


@pytest.fixture
def refusal(typed, data, adapter):
    """Runs the command as a user does; returns the line that it ends with."""

    def refusal(*options: str) -> str:
        typed(*common(adapter, data), *options)
        with pytest.raises(SystemExit) as exit:
            main()
        command, _, line = str(exit.value.code).partition(": ")
        assert command == "gloves calibrate" and "\n" not in line
        assert not (adapter / CALIBRATION_NAME).exists()
        return line

    return refusal


def test_whole_chunks_are_scored_for_every_length(run, adapter, data, caplog):
    calibration = run("--dataset.episodes=[2, 5]")
    assert warnings(caplog) == [
        "no train_config.json beside the weights: cannot check that the training run saw none of these episodes"
    ]
    assert (calibration.repo_id, calibration.episodes) == ("me/tiny", (2, 5))
    scores = calibration.scores["reverse:steps=1"]
    assert scores.shape == (T, 2 * (LENGTH - T + 1))
    policy, (preprocess, _) = load(adapter)
    rows = LeRobotDataset("me/tiny", root=data, episodes=[2, 5]).hf_dataset
    column, first = 5, LENGTH + 1  # four chunks of the first episode, and then the second one of the other
    item = {key: rows[first][key][None] for key in policy.config.input_features}
    chunk = torch.stack([rows[first + i]["action"] for i in range(T)])
    short = torch.cat([chunk[:2], chunk[1:2].expand(T - 2, -1)])
    for length, actions in ((T, chunk), (2, short)):
        batch = preprocess({**item, "action": actions[None]})
        expected = ReverseScore()(policy.bind(batch).expert, batch["action"], length=length)
        torch.testing.assert_close(scores[length - 1, column], expected[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("score", SCORES)
def test_the_gate_scores_a_proposal_as_the_calibration_did(run, adapter, data, tmp_path, score):
    """The command normalises chunks and cuts and pads them then, the wrapper pads raw ones and normalises them then."""
    (scores,) = run("--dataset.episodes=[2, 5]", f"--scores=[{score}]").scores.values()
    agent = save_policy(tmp_path / "agent", "act")
    corrector = wrap(agent, adapter=adapter, gate=True, alpha=0.2, score=score)._corrector
    rows = LeRobotDataset("me/tiny", root=data, episodes=[2, 5]).hf_dataset
    for column, first in ((0, 0), (5, LENGTH + 1)):
        seen = {key: rows[first][key][None] for key in rows.features if key.startswith("observation.")}
        chunk = torch.stack([rows[first + i]["action"] for i in range(T)])[None]
        for length in (T, 2):
            correction = corrector(seen, chunk[:, :length], spawn(0, 1, stream="editor"))
            torch.testing.assert_close(correction.score[0], scores[length - 1, column], rtol=1e-4, atol=1e-5)
            rank, count = int(scores[length - 1].argsort().tolist().index(column)), scores.shape[1]
            # By a hair above the score that it is, it ranks one higher.
            assert round(correction.p_value[0].item() * (count + 1)) in (1 + count - rank, count - rank)


def test_of_the_training_data_what_was_held_out_is_taken(run, adapter, caplog):
    trained(adapter)
    assert run().episodes == (6, 7)
    assert run("--dataset.episodes=[7]").episodes == (7,)
    assert warnings(caplog) == []


def test_without_a_split_it_is_what_the_training_left_out(run, adapter):
    trained(adapter, eval_split=0.0, episodes=[0, 1, 2, 4])
    assert run().episodes == (3, 5, 6, 7)


def test_episodes_that_the_training_saw_are_refused(refusal, adapter):
    trained(adapter)
    line = refusal("--dataset.episodes=[0, 5, 7]")
    assert line.startswith("the training run saw 2 of these episodes: calibrate on others")
    trained(adapter, eval_split=0.0)
    assert refusal().startswith("the training run saw all of these episodes")


def test_another_datasets_episodes_are_all_taken_and_a_line_says_what_was_not_checked(run, adapter, caplog):
    trained(adapter, repo_id="me/other")
    assert run().episodes == tuple(range(EPISODES))
    assert warnings(caplog) == [
        "the adapter was trained on me/other, not on me/tiny: cannot check that the training run saw none of these "
        "episodes"
    ]


def test_a_dataset_without_the_adapters_features_is_refused(refusal, tmp_path):
    write_dataset(tmp_path / "less", episodes=1, leave_out=("observation.environment_state",))
    assert refusal(f"--dataset.root={tmp_path / 'less'}") == (
        "the adapter needs observation.environment_state (12,), but me/tiny has action (2,), "
        "observation.goal (9,), observation.state (4,)"
    )


def test_a_dataset_of_other_actions_is_refused(refusal, tmp_path):
    features = {
        key: {"dtype": "float32", "shape": (size,), "names": [f"{key}_{i}" for i in range(size)]}
        for key, size in (("action", 7), ("observation.state", 4), ("observation.environment_state", 12))
    }
    dataset = LeRobotDataset.create("me/tiny", fps=20, root=tmp_path / "arm", features=features, use_videos=False)
    row = {key: np.zeros(feature["shape"], np.float32) for key, feature in features.items()}
    dataset.add_frame(row | {"task": ""})
    dataset.save_episode()
    dataset.finalize()
    line = refusal(f"--dataset.root={tmp_path / 'arm'}")
    assert line.startswith("the adapter needs action (2,), but me/tiny has action (7,), ")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--dataset.episodes=[7, 8, 99]", "dataset.episodes holds [8, 99], but me/tiny has episodes 0 to 7"),
        ("--scores=[]", "scores is empty: name at least one, such as reverse:steps=1"),
        ("--scores=[revers]", "unknown score 'revers': choose from likelihood, residual, reverse, selfnormalised"),
        ("--stride=0", "stride is 0, but must be at least 1"),
        ("--batch_size=-1", "batch_size is -1, but must be at least 1"),
    ],
)
def test_a_wrong_option_is_named(refusal, option, message):
    assert refusal(option) == message


def test_a_dataset_that_is_nowhere_is_named(refusal, tmp_path):
    line = refusal("--dataset.repo_id=me/nowhere", f"--dataset.root={tmp_path / 'nowhere'}")
    start = f"there is no dataset me/nowhere in {tmp_path / 'nowhere'} (--dataset.root), nor is one to be had from"
    assert line.startswith(start) and "offline" in line.lower()


def test_damaged_processors_are_named(refusal, adapter):
    [file] = adapter.glob("policy_preprocessor_step_*.safetensors")
    file.write_bytes(file.read_bytes()[:20])
    assert refusal().startswith(f"{file} is not a readable safetensors file: ")


def test_what_scores_nothing_is_not_calibrated(typed, data, tmp_path):
    typed(*common(save_policy(tmp_path / "agent", "act"), data))
    with pytest.raises(ValueError, match="agent is a policy of type 'act', which scores nothing: take an adapter"):
        calibrate()
