"""Checkpoints that `lerobot-train --peft.method_type=LORA` leaves: as adapter, in `gloves calibrate`, as agent."""

import re
import shutil

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import make_policy
from lerobot.scripts.lerobot_train import train

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.checkpoints.loading import load_policy, without_peft
from lerobot_gloves.commands.calibrate import calibrate
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import make_policy as make_tiny_policy
from tests.builders import observation, save_policy, training_options, wrap, write_dataset

peft = pytest.importorskip("peft")
GOAL = ("observation.goal",)


def fine_tune(typed, base, data, output, *options):
    arguments = training_options("-", data, output, steps=2)
    kept = [one for one in arguments if not one.startswith("--policy.") or one.startswith("--policy.push")]
    typed(f"--policy.path={base}", *kept, "--peft.method_type=LORA", "--peft.r=2", "--policy.device=cpu", *options)
    train()
    return output / "checkpoints" / "last" / "pretrained_model"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("peft")
    write_dataset(folder / "data", leave_out=GOAL)
    save_policy(folder / "base", "gloves_expert_flow", seed=7)
    return folder


@pytest.fixture(scope="module")
def tuned(folder):
    with pytest.MonkeyPatch.context() as patch:
        typed = lambda *arguments: patch.setattr("sys.argv", ["lerobot-train", *arguments])  # noqa: E731
        return fine_tune(typed, folder / "base", folder / "data", folder / "run", "--policy.optimizer_lr=0.1")


def load(checkpoint):
    config = checkpoint_config("policy.adapter", checkpoint)
    config.pretrained_path = checkpoint
    return load_policy(config, "cpu")


def test_both_networks_are_fine_tuned_from_the_averaged_weights(folder, tuned):
    """By hand: W + B A / (r / alpha) of what PEFT saved, on the averaged weights of the checkpoint it started from."""
    policy, base = load(tuned).policy, make_tiny_policy("gloves_expert_flow", seed=7)
    where = "dit.blocks.0.attention.qkv"
    config = peft.PeftConfig.from_pretrained(tuned)
    for network in (policy.network, policy.averaged):
        layer = network.get_submodule(where)
        a, b = (getattr(layer, f"lora_{part}")["default"].weight for part in "AB")
        assert b.any(), "trained"
        weight = base.averaged.get_submodule(where).weight + config.lora_alpha / config.r * b @ a
        x = torch.randn(3, weight.shape[1], generator=torch.Generator().manual_seed(0))
        expected = x @ weight.T + base.averaged.get_submodule(where).bias
        torch.testing.assert_close(layer(x), expected, rtol=1e-4, atol=1e-6)


def test_the_average_follows_the_layers_that_are_trained(folder):
    policy = make_tiny_policy("gloves_expert_flow", seed=7)
    with torch.no_grad():
        for weight in policy.network.parameters():
            weight += 1  # far from their average
    before = {name: value.clone() for name, value in policy.averaged.state_dict().items()}
    policy.config.pretrained_path = folder / "base"
    wrapped = policy.wrap_with_peft(peft_cli_overrides={"method_type": "lora", "r": 2})
    for name, value in policy.averaged.state_dict().items():
        assert torch.equal(value, policy.network.state_dict()[name])
        plain = name.replace(".base_layer", "")
        assert "lora_" in name or torch.equal(value, before[plain])
    with torch.no_grad():
        for name, value in policy.network.named_parameters():
            if "lora_B" in name:
                value += 1
    for _ in range(50):
        wrapped.update()
    qkv = policy.averaged.get_submodule("dit.blocks.0.attention.qkv").lora_B["default"].weight
    assert (qkv > 0.9).all(), "it warms up again, whatever number of updates the base had"


def test_layers_of_one_network_alone_are_refused(folder):
    policy = make_tiny_policy("gloves_expert_flow", seed=7)
    policy.config.pretrained_path = folder / "base"
    with pytest.raises(ValueError, match=r"--peft\.target_modules must name .* alike.* in one alone") as error:
        policy.wrap_with_peft(peft_cli_overrides={"target_modules": r"network\..*\.qkv", "r": 2})
    assert "\n" not in str(error.value)


def test_it_corrects_as_an_adapter(checkpoints, folder, tuned):
    batch, given = observation(2), {}
    for name, adapter in (("base", folder / "base"), ("tuned", tuned)):
        given[name] = wrap(checkpoints.agent, adapter=adapter, method="feeg:start=0.3").select_action(batch)
    assert given["tuned"].isfinite().all() and (given["tuned"] != given["base"]).any(dim=1).all()
    wrapper = wrap(checkpoints.agent, adapter=tuned, method="feeg:start=0.3")
    assert torch.equal(wrapper.select_action(batch), given["tuned"])


def test_it_is_calibrated_and_gates(checkpoints, folder, tuned, typed):
    typed(
        f"--policy.path={tuned}",
        "--dataset.repo_id=me/tiny",
        f"--dataset.root={folder / 'data'}",
        "--scores=[reverse:steps=1]",
        "--stride=1",
    )
    calibration = calibrate()
    assert Calibration.load(tuned).weights == calibration.weights
    policy = wrap(checkpoints.agent, adapter=tuned, gate=True, alpha=0.5)
    policy.select_action(observation(2))
    assert policy.correction.p_value is not None
    with pytest.raises(ValueError, match="belongs to other weights"):
        calibration.save(folder / "base")
        wrap(checkpoints.agent, adapter=folder / "base", gate=True)
    (folder / "base" / "calibration.safetensors").unlink()


def test_it_is_an_agent_as_lerobot_loads_it(tuned, checkpoints):
    config = PreTrainedConfig.from_pretrained(tuned)
    config.pretrained_path = tuned
    bare, loaded = make_policy(config, env_cfg=SlalomEnv()).eval(), load(tuned)
    assert type(bare).__name__.startswith("Peft") and without_peft(bare) is not bare
    wrapper, batch = wrap(tuned), observation(2)
    expected = loaded.postprocess(bare.select_action(loaded.preprocess(dict(batch))))
    assert torch.equal(wrapper.select_action(batch), expected)


def test_what_it_started_from_counts_in_its_hash_and_is_missed(folder, tuned, tmp_path):
    base, copied = tmp_path / "base", tmp_path / "tuned"
    shutil.copytree(folder / "base", base)
    shutil.copytree(tuned, copied)
    said = copied / "adapter_config.json"
    text = re.sub(r'("base_model_name_or_path": )"[^"]*"', rf'\1"{base}"', said.read_text())
    said.write_text(text)
    before = checkpoint_hash(str(copied))
    save_policy(base, "gloves_expert_flow", seed=8)
    assert checkpoint_hash(str(copied)) != before
    shutil.rmtree(base)
    with pytest.raises(ValueError, match=r"was fine-tuned by PEFT from .*base_model_name_or_path") as error:
        load(copied)
    assert "\n" not in str(error.value)
