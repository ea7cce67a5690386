import huggingface_hub.constants as constants
import torch
from huggingface_hub import HfApi
from lerobot.policies import get_policy_class

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from tests.builders import load, observation, save_policy, wrap


def test_a_pushed_expert_flow_carries_its_calibration(checkpoints, online):
    expert = get_policy_class("gloves_expert_flow").from_pretrained(checkpoints.adapter)
    expert.push_to_hub("tester/expert")
    files = online.repositories["models", "tester/expert"].files
    assert files[CALIBRATION_NAME] == (checkpoints.adapter / CALIBRATION_NAME).read_bytes()
    assert files["model.safetensors"] == (checkpoints.adapter / "model.safetensors").read_bytes()
    pulled = get_policy_class("gloves_expert_flow").from_pretrained("tester/expert")
    assert pulled.calibration.weights == expert.calibration.weights
    assert Calibration.load("tester/expert").episodes == (7, 8)


def test_an_uncalibrated_one_on_the_hub_has_none(tmp_path, online):
    expert, _ = load(save_policy(tmp_path / "expert", "gloves_expert_flow"))
    expert.push_to_hub("tester/plain")
    assert Calibration.load("tester/plain") is None
    assert get_policy_class("gloves_expert_flow").from_pretrained("tester/plain").calibration is None


def test_a_hub_out_of_reach_is_not_taken_for_an_adapter_without_a_calibration(online, monkeypatch, caplog):
    HfApi().create_repo("tester/nothing")
    assert Calibration.load("tester/nothing") is None and not caplog.records
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    assert Calibration.load("tester/nothing") is None
    (record,) = caplog.records
    assert record.getMessage() == "the Hub is out of reach: tester/nothing is used without the calibration it may have"


def test_agent_adapter_and_wrapper_are_taken_from_the_hub(checkpoints, online):
    for name, folder in [("agent", checkpoints.agent), ("adapter", checkpoints.adapter)]:
        HfApi().create_repo(f"tester/{name}")
        HfApi().upload_folder(repo_id=f"tester/{name}", folder_path=folder)
    policy = wrap("tester/agent", adapter="tester/adapter", gate=True)
    local = wrap(checkpoints.agent, adapter=checkpoints.adapter, gate=True)
    batch = observation(2)
    with torch.inference_mode():
        expected = [local.select_action(batch) for _ in range(7)]
        assert all(torch.equal(policy.select_action(batch), action) for action in expected)
    policy.push_to_hub("tester/wrapper")
    wrapper, _ = load("tester/wrapper")
    with torch.inference_mode():
        assert all(torch.equal(wrapper.select_action(batch), action) for action in expected)
