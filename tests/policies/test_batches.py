"""Batches of a LeRobotDataset, beside its own items one by one."""

import subprocess
import sys
import tempfile

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.policies import get_policy_class
from lerobot.transforms import ImageTransforms, ImageTransformsConfig
from torch.utils.data import DataLoader, Subset

from gloves_flow import batches
from gloves_flow.frames import Frames
from tests.builders import CAMERA, SIZE, make_config, make_policy, write_dataset

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


@pytest.fixture(params=["image", "video"])
def filmed(request, tmp_path):
    """Opens a dataset with a camera, whose frames are stored one by one or as a video."""
    write_dataset(tmp_path / "data", "pixels_agent_pos", episodes=3, length=(3, 5, 4), video=request.param == "video")

    def open(**options):
        ahead = {"action": [0.0, 0.05]}
        return LeRobotDataset("me/tiny", root=tmp_path / "data", **{"delta_timestamps": ahead, **options})

    return open


@pytest.mark.parametrize("options", [{}, {"episodes": [0, 2]}, {"return_uint8": True}])
def test_frames_are_lerobots_to_the_bit_and_decoded_once(filmed, options, monkeypatch):
    data = filmed(**options)
    order = [5, 1, 6, 5, 0]
    expected = [data[index] for index in order]
    for _ in range(2):
        assert_same(data.__getitems__(order), expected)
        for source in ("_decode", "_keep"):  # from here on there is nothing to be decoded
            monkeypatch.setattr(Frames, source, None)
    assert expected[0][CAMERA].shape == (3, SIZE, SIZE) and expected[0][CAMERA].float().std() > 0


def test_a_frame_that_is_handed_out_is_a_copy(filmed):
    data = filmed(return_uint8=True)
    expected = data[1][CAMERA]
    for _ in range(3):
        (found,) = data.__getitems__([1])
        assert torch.equal(found[CAMERA], expected)
        found[CAMERA].zero_()


def test_augmented_frames_draw_as_lerobots_do(filmed):
    augmented = filmed(image_transforms=ImageTransforms(ImageTransformsConfig(enable=True)))
    plain = filmed()
    for _ in range(2):
        torch.manual_seed(0)
        found = augmented.__getitems__([4, 1])
        torch.manual_seed(0)
        assert_same(found, [augmented[4], augmented[1]])
        assert (found[0][CAMERA] != plain[4][CAMERA]).any()
    augmented.clear_image_transforms()
    assert_same(augmented.__getitems__([4, 1]), [plain[4], plain[1]])


def test_what_are_no_bytes_or_have_no_room_is_decoded_at_every_visit(filmed, monkeypatch, caplog):
    data, full = filmed(), filmed()
    expected = [data[index] for index in (4, 1)]

    def refuse(**_):
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "TemporaryFile", refuse)
        for _ in range(2):
            assert_same(full.__getitems__([4, 1]), expected)
    assert caplog.text.count("no room for 0.0 GB of frames (no space left on device)") == 1
    decode, keep, decoded = Frames._decode, Frames._keep, []

    def count(frames, row, episode):
        decoded.append(row)
        return decode(frames, row, episode)

    monkeypatch.setattr(Frames, "_keep", lambda frames, key, row, frame: keep(frames, key, row, frame * 0.3))
    monkeypatch.setattr(Frames, "_decode", count)
    for _ in range(2):
        assert_same(data.__getitems__([4, 1]), expected)
    assert decoded == [4, 1, 4, 1], "a frame that is no bytes is not rounded to them"


def test_of_a_video_no_more_is_decoded_than_is_asked_for(filmed, monkeypatch):
    """A whole episode of a batch's every item would not fit into memory."""
    data, asked, query = filmed(), [], DatasetReader._query_videos

    def note(reader, timestamps, episode):
        asked.append([len(times) for times in timestamps.values()])
        return query(reader, timestamps, episode)

    monkeypatch.setattr(DatasetReader, "_query_videos", note)
    data.__getitems__([4, 1, 4])
    assert asked == ([[1], [1]] if data.meta.video_keys else [])


def test_what_is_more_than_numbers_and_one_frame_is_lerobots_own(filmed):
    several = filmed(delta_timestamps={CAMERA: [-0.05, 0.0]})
    assert batches.Columns.of(several) is None
    assert_same(several.__getitems__([4, 1]), [several[4], several[1]])


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
