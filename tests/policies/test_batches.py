"""Batches of a LeRobotDataset, beside its own items one by one."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import get_policy_class
from lerobot.transforms import ImageTransforms, ImageTransformsConfig
from torch.utils.data import DataLoader, Subset

from gloves_flow import batches
from tests.builders import SIZE, make_config, make_policy, write_dataset

AHEAD = {"action": [-0.1, 0.0, 0.05], "observation.state": [-0.05, 0.0]}
FEATURES = {
    "observation.state": {"dtype": "float64", "shape": (3,), "names": ["a", "b", "c"]},
    "observation.gripper": {"dtype": "int32", "shape": (1,), "names": ["width"]},
    "observation.switches": {"dtype": "bool", "shape": (2,), "names": ["left", "right"]},
    "observation.touch": {"dtype": "float32", "shape": (2, 2), "names": ["row", "column"]},
    "action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
}


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    monkeypatch.setattr(LeRobotDataset, "__getitems__", batches.read_batch, raising=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Columns of many types, and episodes of different lengths and instructions."""
    root = tmp_path_factory.mktemp("types") / "data"
    dataset = LeRobotDataset.create("me/types", fps=20, root=root, features=FEATURES, use_videos=False)
    rng = np.random.default_rng(0)
    for length in (3, 5, 4):
        for _ in range(length):
            frame = {
                "observation.state": rng.normal(size=3),
                "observation.gripper": rng.integers(0, 9, size=1).astype(np.int32),
                "observation.switches": rng.random(2) > 0.5,
                "observation.touch": rng.normal(size=(2, 2)).astype(np.float32),
                "action": rng.normal(size=2).astype(np.float32),
            }
            dataset.add_frame({**frame, "task": f"task of {length}"})
        dataset.save_episode()
    dataset.finalize()
    return root


def assert_same(found, expected):
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.keys() == other.keys()
        for key, value in other.items():
            if isinstance(value, torch.Tensor):
                torch.testing.assert_close(one[key], value, rtol=0, atol=0, msg=key)
            else:
                assert one[key] == value


@pytest.mark.parametrize("episodes", [None, [0, 2], [1]])
@pytest.mark.parametrize("ahead", [None, AHEAD])
def test_items_are_lerobots_to_the_bit(folder, episodes, ahead):
    data = LeRobotDataset("me/types", root=folder, episodes=episodes, delta_timestamps=ahead)
    order = [*reversed(range(len(data))), 0, 0]
    assert batches.Columns.of(data) is not None
    assert_same(data.__getitems__(order), [data[index] for index in order])


def test_images_come_as_they_are_stored(tmp_path):
    write_dataset(tmp_path / "data", "pixels_agent_pos", episodes=2, length=3)
    data = LeRobotDataset("me/tiny", root=tmp_path / "data", delta_timestamps={"action": [0.0, 0.05]})
    assert batches.Columns.of(data) is not None
    found = data.__getitems__([4, 1])
    assert_same(found, [data[4], data[1]])
    assert found[0]["observation.images.front"].shape == (3, SIZE, SIZE)


def test_what_is_more_than_stored_numbers_is_lerobots_own(tmp_path):
    write_dataset(tmp_path / "data", "pixels_agent_pos", episodes=2, length=3)
    transforms = ImageTransforms(ImageTransformsConfig(enable=True))
    augmented = LeRobotDataset("me/tiny", root=tmp_path / "data", image_transforms=transforms)
    several = LeRobotDataset(
        "me/tiny", root=tmp_path / "data", delta_timestamps={"observation.images.front": [-0.05, 0.0]}
    )
    for data in (augmented, several):
        assert batches.Columns.of(data) is None
    assert_same(several.__getitems__([4, 1]), [several[4], several[1]])
    torch.manual_seed(0)
    found = augmented.__getitems__([4, 1])
    torch.manual_seed(0)
    assert_same(found, [augmented[4], augmented[1]])


def test_a_dataset_that_is_recorded_is_asked_item_by_item(tmp_path):
    data = LeRobotDataset.create("me/new", fps=20, root=tmp_path / "new", features=FEATURES, use_videos=False)
    with pytest.raises(RuntimeError, match="finalize"):
        data.__getitems__([0])
    assert_same(write_dataset(tmp_path / "data").__getitems__([1]), [write_dataset(tmp_path / "again")[1]])


def test_a_loader_reads_an_item_of_lerobots_no_more(folder, monkeypatch):
    data = LeRobotDataset("me/types", root=folder, delta_timestamps=AHEAD)
    expected = next(iter(DataLoader([data[index] for index in range(4, 8)], batch_size=4)))
    monkeypatch.setattr(LeRobotDataset, "__getitem__", None)
    for some in (data, Subset(data, range(4, 8))):
        loader = DataLoader(some, batch_size=4)
        (found,) = [batch for number, batch in enumerate(loader) if number == (some is data)]
        assert_same([found], [expected])


def test_a_flow_that_is_made_for_a_training_installs_it_and_an_import_does_not(folder, monkeypatch):
    monkeypatch.delattr(LeRobotDataset, "__getitems__")
    make_policy("gloves_expert_flow")
    assert not hasattr(LeRobotDataset, "__getitems__")
    meta = LeRobotDataset("me/types", root=folder).meta
    get_policy_class("gloves_expert_flow")(make_config("gloves_expert_flow"), dataset_meta=meta)
    assert LeRobotDataset.__getitems__ is batches.read_batch
    imported = "import sys, lerobot_policy_gloves; sys.exit('lerobot.datasets' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", imported], capture_output=True).returncode == 0
