import json

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration, weights_hash
from lerobot_gloves.conformal import ConformalGate

ROWS = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


def make_calibration(**changes) -> Calibration:
    fields = {
        "scores": {"reverse:steps=1": ROWS, "reverse:steps=5": 10 * ROWS},
        "repo_id": "me/expert",
        "revision": "v3.0",
        "episodes": (3, 7),
        "weights": "0" * 64,
        "episode_of": (7, 3, 7),
    }
    return Calibration(**{**fields, **changes})


def test_what_is_saved_is_loaded(tmp_path):
    calibration = make_calibration()
    calibration.save(tmp_path)
    loaded = Calibration.load(tmp_path)
    assert (loaded.repo_id, loaded.revision, loaded.episodes) == ("me/expert", "v3.0", (3, 7))
    assert (loaded.weights, loaded.episode_of) == (calibration.weights, (7, 3, 7))
    assert loaded.scores.keys() == calibration.scores.keys()
    assert torch.equal(loaded.of("reverse:steps=5", 2), torch.tensor([40.0, 50.0, 60.0]))
    assert [path.name for path in tmp_path.iterdir()] == [CALIBRATION_NAME]  # nothing half written is left


def test_a_checkpoint_without_one_has_none(tmp_path):
    assert Calibration.load(tmp_path) is None


def test_each_length_has_its_own_scores():
    calibration = make_calibration()
    assert calibration.of("reverse:steps=1", 1).tolist() == [1, 2, 3]
    assert calibration.of("reverse:steps=1", 2).tolist() == [4, 5, 6]


def test_an_episodes_score_is_its_worst_chunks():
    assert make_calibration().of("reverse:steps=1", 2, by_episode=True).tolist() == [5, 6]  # of episodes 3 and 7
    assert make_calibration(episode_of=(1, 1, 1)).of("reverse:steps=1", 1, by_episode=True).tolist() == [3]


def test_a_calibration_of_before_does_not_know_episodes(tmp_path):
    about = {"repo_id": "me/expert", "revision": "v3.0", "episodes": [3], "weights": "0" * 64, "guidance": 1.0}
    save_file({"reverse:steps=1": ROWS}, tmp_path / CALIBRATION_NAME, metadata={"gloves": json.dumps(about)})
    old = Calibration.load(tmp_path)
    assert old.of("reverse:steps=1", 1).tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="does not say which chunks are of one episode: run gloves calibrate again"):
        old.of("reverse:steps=1", 1, by_episode=True)


def test_by_episode_at_most_alpha_of_exchangeable_episodes_are_ever_touched():
    """Each of 40 episodes of 25 chunks against the other 39; an episode's chunks are much alike."""
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(40, 1)) + 0.5 * rng.normal(size=(40, 25))
    touched = {}
    for by_episode in (False, True):
        touched[by_episode] = 0
        for left_out, own in enumerate(drawn):
            rest = torch.tensor(np.delete(drawn, left_out, axis=0))
            of = tuple(np.repeat(np.arange(39), 25).tolist())
            calibration = make_calibration(scores={"reverse": rest.flatten()[None]}, episode_of=of)
            gate = ConformalGate(calibration.of("reverse", 1, by_episode=by_episode), alpha=0.1)
            touched[by_episode] += not gate.admits(torch.tensor(own)).all()
    assert touched[True] == 4, "no two maxima are equal, so exactly alpha"
    assert touched[False] > 8, "chunk by chunk many more episodes have one that is turned away"


@pytest.mark.parametrize("length", [0, 3])
def test_a_length_that_was_not_calibrated_is_refused(length):
    with pytest.raises(ValueError, match=f"lengths 1 to 2, not {length}"):
        make_calibration().of("reverse:steps=1", length)


def test_an_uncalibrated_score_is_refused_with_those_that_are():
    with pytest.raises(ValueError, match="'reverse:steps=2', only for reverse:steps=1, reverse:steps=5"):
        make_calibration().of("reverse:steps=2", 1)


def test_other_weights_are_refused():
    calibration = make_calibration(weights="a" * 64)
    calibration.check("a" * 64)
    with pytest.raises(
        ValueError, match="belongs to other weights \\(aaaaaaaaaaaa\\) than the adapter's \\(bbbbbbbbbbbb\\)"
    ):
        calibration.check("b" * 64)


@pytest.mark.parametrize("damage", ["truncated", "foreign", "incomplete", "no_json", "empty"])
def test_a_damaged_file_is_one_clear_line(tmp_path, damage):
    make_calibration().save(tmp_path)
    path = tmp_path / CALIBRATION_NAME
    content = path.read_bytes()
    about = {"repo_id": "me/expert", "revision": "v3.0", "episodes": [3]}
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "foreign":
        save_file({"weight": ROWS}, path)
    else:
        save_file(
            {"reverse:steps=1": ROWS}, path, metadata={"gloves": json.dumps(about) if damage == "incomplete" else "{"}
        )
    with pytest.raises(ValueError, match="is not a readable calibration") as error:
        Calibration.load(tmp_path)
    assert CALIBRATION_NAME in str(error.value) and "\n" not in str(error.value)


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path):
    with pytest.raises(OSError, match=f"cannot write {tmp_path / 'gone' / CALIBRATION_NAME}: "):
        make_calibration().save(tmp_path / "gone")


def test_a_save_that_fails_leaves_the_last_one(tmp_path, monkeypatch):
    make_calibration().save(tmp_path)

    def full(*_, **__):
        raise OSError("no space left on device")

    monkeypatch.setattr("lerobot_gloves.checkpoints.calibration.save_file", full)
    with pytest.raises(OSError, match="no space"):
        make_calibration(revision="other").save(tmp_path)
    assert Calibration.load(tmp_path).revision == "v3.0"


def test_the_hash_is_of_names_types_shapes_and_values():
    weights = {"a": torch.arange(4.0), "b": torch.tensor(1), "empty": torch.zeros(0, 3)}
    reference = weights_hash(weights)
    assert reference == weights_hash(dict(reversed(weights.items())))  # of no order
    assert reference == weights_hash({key: value.clone() for key, value in weights.items()})
    others = [
        {**weights, "a": torch.arange(4.0).view(2, 2)},
        {**weights, "a": torch.arange(4.0).double()},
        {**weights, "a": torch.tensor([0.0, 1.0, 2.0, 3.0000002])},
        {**weights, "b": torch.tensor(2)},
        {**weights, "empty": torch.zeros(3, 0)},
        {"c" if key == "b" else key: value for key, value in weights.items()},
    ]
    assert len({reference, *map(weights_hash, others)}) == 1 + len(others)
    assert weights_hash({"a": torch.arange(6.0).view(2, 3).t()}) == weights_hash(
        {"a": torch.arange(6.0).view(2, 3).t().contiguous()}
    )
    assert weights_hash({"a": torch.ones(3, dtype=torch.bfloat16)}) != weights_hash(
        {"a": torch.zeros(3, dtype=torch.bfloat16)}
    )
