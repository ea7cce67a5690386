"""What a wrapper says when it is made: what is missing, and what does not fit though it has the right size."""

import logging

import pytest
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from tests.builders import make_config, save_policy, wrap, write_dataset

JOINTS, POSE = ["shoulder.pos", "elbow.pos"], ["x", "y"]


def test_without_an_adapter_a_warning_says_that_nothing_is_corrected(checkpoints, caplog):
    with caplog.at_level(logging.WARNING):
        wrap(checkpoints.agent, adapter=checkpoints.adapter)
        assert "no adapter" not in caplog.text
        wrap(checkpoints.agent)
    [told] = [record for record in caplog.records if "no adapter" in record.message]
    assert told.levelno == logging.WARNING and "\n" not in told.message
    assert str(checkpoints.agent) in told.message and "--policy.adapter" in told.message


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """Agents and adapters whose actions are two joints, a position, or who knows what."""
    folder = tmp_path_factory.mktemp("named")
    made = {}
    for kind in ("gloves_flow_policy", "gloves_expert_flow"):
        for label, names in (("joints", JOINTS), ("pose", POSE), ("nobody knows", None)):
            made[kind, label] = save_policy(folder / kind / label, kind, action_feature_names=names)
    return made


@pytest.mark.parametrize(("ours", "theirs"), [("joints", "pose"), ("pose", "joints")])
def test_joints_are_not_a_pose_though_equally_many(named, ours, theirs):
    agent, adapter = named["gloves_flow_policy", ours], named["gloves_expert_flow", theirs]
    with pytest.raises(ValueError, match=r"the adapter's actions are .*, but the agent's are ") as error:
        wrap(agent, adapter=adapter)
    assert "\n" not in str(error.value) and all(name in str(error.value) for name in (*JOINTS, *POSE))
    wrap(agent, adapter=adapter, adapter_overrides=["--action_feature_names=null"])


@pytest.mark.parametrize(
    ("ours", "theirs"), [("joints", "joints"), ("nobody knows", "pose"), ("joints", "nobody knows")]
)
def test_the_same_names_fit_and_so_does_what_nobody_knows(named, ours, theirs):
    wrap(named["gloves_flow_policy", ours], adapter=named["gloves_expert_flow", theirs])


def test_names_are_learnt_from_the_dataset(tmp_path):
    write_dataset(tmp_path / "data")
    policy = make_policy(make_config("gloves_expert_flow"), LeRobotDatasetMetadata("me/tiny", root=tmp_path / "data"))
    policy.save_pretrained(tmp_path / "saved")
    assert type(policy.config).from_pretrained(tmp_path / "saved").action_feature_names == ["action_0", "action_1"]
