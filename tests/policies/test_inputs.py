"""Observations of every shape and type train and are read as what they are, or one line says what to leave out."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies import make_pre_post_processors
from lerobot.utils.feature_utils import dataset_to_policy_features
from torch.utils.data import DataLoader

from lerobot_gloves.networks import VelocityNetwork
from tests.builders import (
    CAMERA,
    SIZE,
    awaken,
    features,
    load,
    make_config,
    make_policy,
    observation,
    save_policy,
    wrap,
)

ODD = {
    "observation.gripper": ("float32", (1,)),
    "observation.tactile": ("float32", (4, 5)),
    "observation.lamp": ("int64", (1,)),
    "observation.switch": ("bool", (1,)),
    "observation.force": ("float64", (3,)),
}
KINDS = ["gloves_expert_flow", "gloves_copilot", "gloves_align_flow", "gloves_flow_policy"]


@pytest.fixture(scope="module")
def odd(tmp_path_factory) -> LeRobotDataset:
    """A robot with a gripper, a skin, a lamp, a switch and a force sensor beside its joints."""
    kinds = {**ODD, "observation.state": ("float32", (4,)), "action": ("float32", (2,))}
    columns = {key: {"dtype": dtype, "shape": shape, "names": None} for key, (dtype, shape) in kinds.items()}
    root = tmp_path_factory.mktemp("odd") / "data"
    dataset = LeRobotDataset.create("me/odd", fps=20, root=root, features=columns, use_videos=False)
    rng = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(8):
            row = {key: (3 * rng.normal(size=shape) + 1).astype(dtype) for key, (dtype, shape) in kinds.items()}
            row["observation.switch"] = rng.integers(2, size=1).astype(bool)
            dataset.add_frame({**row, "task": "agent: noised, chunks of 6" if dataset.num_episodes else "0 2 3"})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset("me/odd", root=root)


@pytest.mark.parametrize("kind", KINDS)
def test_every_shape_and_type_trains(odd, kind):
    """As `lerobot-train` does it. What the numbers become is told by those that were written down."""
    shapes = dataset_to_policy_features(odd.meta.features)
    action = {"action": shapes.pop("action")}
    goal = {"observation.goal": PolicyFeature(FeatureType.STATE, (1,))} if kind == "gloves_flow_policy" else {}
    config = make_config(kind, input_features=shapes | goal, output_features=action)
    policy = type(make_policy(kind))(config, dataset_meta=odd.meta)
    awaken(policy)
    before, _ = make_pre_post_processors(config, dataset_stats=odd.meta.stats)
    windows = resolve_delta_timestamps(config, odd.meta)
    windowed = LeRobotDataset("me/odd", root=odd.root, delta_timestamps=windows)
    (batch,) = DataLoader(windowed, batch_size=len(windowed))
    if goal:
        batch["observation.goal"] = torch.arange(16)  # what the loader makes of a single number
    ready = before(batch)
    for key, (dtype, shape) in ODD.items():
        written = np.stack([np.asarray(one) for one in odd.hf_dataset[key]]).reshape(16, *shape).astype(np.float64)
        pooled = tuple(range(written.ndim - 1))  # as LeRobot's statistics are
        expected = (written - written.mean(axis=pooled)) / (written.std(axis=pooled) + 1e-8)
        assert ready[key].dtype == torch.float32
        assert np.allclose(ready[key].reshape(16, *shape).numpy(), expected, atol=1e-4), (key, dtype)
    loss, _ = policy.train()(ready)
    loss.backward()
    assert loss.isfinite() and policy.network.state_encoder.layers[0].weight.shape[1] == 1 + 20 + 1 + 1 + 3 + 4
    assert (policy.network.state_encoder.layers[0].weight.grad.abs().sum(dim=0) > 0).all()
    assert policy.eval().predict_action_chunk(ready).isfinite().all()


def test_a_shape_is_read_row_by_row_and_a_single_number_with_or_without_a_dimension_of_its_own():
    torch.manual_seed(0)
    network = VelocityNetwork(2, states={"skin": 20, "grip": 1}, context_dim=8, width=8, depth=1, heads=2, time_dim=8)
    skin, grip = torch.randn(3, 4, 5), torch.randn(3)
    tokens = network.encode({"skin": skin, "grip": grip})
    assert torch.equal(tokens, network.encode({"skin": skin.reshape(3, 20), "grip": grip[:, None]}))
    assert not torch.allclose(tokens, network.encode({"skin": skin.mT.reshape(3, 20), "grip": grip}))
    with pytest.raises(ValueError, match=r"skin has shape \(3, 4, 4\), but must hold 20 numbers an item"):
        network.encode({"skin": skin[..., :4], "grip": grip})


@pytest.fixture(scope="module")
def seeing(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeing")
    agent = save_policy(folder / "agent", "gloves_flow_policy", "pixels_agent_pos")
    return agent, save_policy(folder / "adapter", "gloves_expert_flow", "pixels_agent_pos")


@pytest.mark.parametrize("dtype", [torch.float32, torch.int32, torch.float64])
def test_millimetres_are_not_taken_for_colours(seeing, dtype):
    agent, adapter = seeing
    batch = observation(2, "pixels_agent_pos")
    colours = wrap(agent, adapter=adapter).select_action(batch)
    assert colours.isfinite().all()
    _, (before, _) = load(adapter)
    before({**batch, CAMERA: batch[CAMERA].mul(1.01)})  # as an augmentation may leave it
    depth = {**batch, CAMERA: (17846 * batch[CAMERA] / batch[CAMERA].max()).to(dtype)}
    with pytest.raises(
        ValueError, match=f"{CAMERA} holds values up to 1784[0-9.]+, but colours lie between 0 a"
    ) as error:
        before(depth)
    excluded = json.dumps(["observation.goal", CAMERA])
    assert "\n" not in str(error.value) and f"--policy.exclude_features='{excluded}'" in str(error.value)


@pytest.mark.parametrize("channels", [1, 2, 4])
def test_an_image_of_other_channels_is_one_line_that_says_what_to_leave_out(channels):
    """As LeRobot describes its depth maps."""
    described = {"dtype": "video", "shape": (SIZE, SIZE, channels), "names": ["height", "width", "channels"]}
    depth = dataset_to_policy_features({"observation.images.depth": {**described, "info": {"is_depth_map": True}}})
    inputs, outputs = features("pixels_agent_pos")
    with pytest.raises(ValueError) as error:
        make_policy("gloves_expert_flow", input_features=inputs | depth, output_features=outputs)
    option = '--policy.exclude_features=\'["observation.goal", "observation.images.depth"]\''
    told = f"observation.images.depth has {channels} channels, but a colour image has 3: leave it out by {option}"
    assert str(error.value) == f"gloves_expert_flow: {told}"
    left_out = json.loads(option.partition("'")[2].rstrip("'"))
    make_policy("gloves_expert_flow", input_features=inputs | depth, exclude_features=left_out)


def test_what_is_left_out_may_be_anything(seeing):
    """The batch of a training holds all that its dataset holds."""
    _, (before, _) = load(seeing[1])
    batch = observation(2, "pixels_agent_pos")
    before({**batch, "observation.images.depth": torch.full((2, 1, 8, 8), 9e3), "observation.note": ["a", "b"]})


def test_what_is_no_number_is_one_line_that_says_what_to_leave_out():
    inputs, outputs = features()
    note = dataset_to_policy_features({"observation.note": {"dtype": "string", "shape": (1,), "names": None}})
    config = make_config("gloves_expert_flow", input_features=inputs | note, output_features=outputs)
    before, _ = make_pre_post_processors(config, dataset_stats={})
    with pytest.raises(
        ValueError, match=r"observation\.note holds no numbers: train without it, --policy\.exclude_feature"
    ):
        before({**observation(2), "observation.note": ["hot", "cold"]})
