import logging

import pytest
import torch
from lerobot.policies import get_policy_class, make_pre_post_processors
from safetensors.torch import load_file, save_file
from torchvision.models import ResNet18_Weights

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration, weights_hash
from tests.builders import calibrate, make_policy, observation, save_policy

WEIGHTS = "model.safetensors"


@pytest.fixture
def expert(tmp_path):
    """A checkpoint whose average differs from its trained weights."""
    policy = make_policy("gloves_expert_flow")
    with torch.no_grad():
        for parameter in policy.network.parameters():
            parameter.add_(0.1)
    policy.update()
    with torch.no_grad():
        for parameter in policy.network.parameters():
            parameter.add_(0.1)
    policy.update()
    return save_policy(tmp_path / "expert", "gloves_expert_flow", policy=policy)


def load(folder, kind: str = "gloves_expert_flow"):
    return get_policy_class(kind).from_pretrained(folder)


def same(first, second) -> bool:
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)


def test_a_checkpoint_comes_back_bit_for_bit(expert, tmp_path):
    policy = load(expert)
    save_policy(tmp_path / "again", "gloves_expert_flow", policy=policy)
    again = load(tmp_path / "again")
    assert same(policy.state_dict(), again.state_dict())
    assert same(load_file(expert / WEIGHTS), policy.state_dict())
    assert not torch.equal(policy.network.dit.head.bias, policy.ema.module.dit.head.bias)
    data = observation(2)
    assert torch.equal(policy.predict_action_chunk(data), again.predict_action_chunk(data))
    assert again.config.input_features == policy.config.input_features
    for p in (policy, again):  # the average goes on where it was
        p.network.requires_grad_(False)
        p.network.dit.head.bias.add_(1)
        p.update()
    assert same(policy.state_dict(), again.state_dict())


def test_processors_come_back(expert):
    policy = load(expert)
    preprocess, postprocess = make_pre_post_processors(policy.config, str(expert))
    data = observation(2)
    prepared = preprocess(dict(data))
    assert not torch.allclose(prepared["observation.state"], data["observation.state"])
    chunk = torch.randn(2, 6, 2)
    normalised = preprocess({**data, "action": postprocess(chunk)})["action"]
    torch.testing.assert_close(normalised, chunk, rtol=1e-3, atol=1e-4)


def test_the_average_alone_is_a_complete_checkpoint(expert):
    whole = load(expert)
    weights = {key: value for key, value in load_file(expert / WEIGHTS).items() if not key.startswith("network.")}
    save_file(weights, expert / WEIGHTS)
    slim = load(expert)
    data = observation(2)
    assert torch.equal(slim.predict_action_chunk(data), whole.predict_action_chunk(data))
    assert same(slim.network.state_dict(), whole.ema.module.state_dict())  # so that training may go on from there


def test_loading_a_checkpoint_fetches_nothing(tmp_path, monkeypatch):
    name = "ResNet18_Weights.IMAGENET1K_V1"
    weights = make_policy("gloves_expert_flow", "pixels_agent_pos").network.image_encoders[0].backbone.state_dict()
    resnet = {"0": "conv1", "1": "bn1", "4": "layer1", "5": "layer2", "6": "layer3"}
    weights = {f"{resnet[key.split('.')[0]]}.{key.split('.', 1)[1]}": value for key, value in weights.items()}

    def fetch(*_, **__):
        # torchvision's file has the last stage and the head too.
        from torchvision.models import resnet18

        return {**resnet18(weights=None).state_dict(), **weights}

    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", fetch)
    policy = make_policy("gloves_expert_flow", "pixels_agent_pos", pretrained_backbone_weights=name)
    folder = save_policy(tmp_path / "expert", "gloves_expert_flow", policy=policy)

    def never(*_, **__):
        raise AssertionError("fetched")

    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", never)
    loaded = load(folder)
    assert loaded.config.pretrained_backbone_weights == name
    assert same(loaded.state_dict(), policy.state_dict())
    config = policy.config
    config.pretrained_path = None
    again = get_policy_class("gloves_expert_flow").from_pretrained(folder, config=config)
    assert same(again.state_dict(), policy.state_dict())


def damage_truncated(path):
    path.write_bytes(path.read_bytes()[:-100])


def damage_cut_in_the_header(path):
    path.write_bytes(path.read_bytes()[:50])


def damage_empty(path):
    path.write_bytes(b"")


def damage_text(path):
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")


def damage_missing(path):
    path.unlink()


def damage_foreign(path):
    save_file({"model.layer.weight": torch.zeros(3)}, path)


def damage_half_of_the_weights(path):
    weights = load_file(path)
    save_file({key: weights[key] for key in list(weights)[::2]}, path)


def damage_other_size(path):
    weights = load_file(path)
    save_file({**weights, "ema.module.dit.embed.weight": torch.zeros(16, 3)}, path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_truncated, "is not a readable safetensors file"),
        (damage_cut_in_the_header, "is not a readable safetensors file"),
        (damage_empty, "is not a readable safetensors file"),
        (damage_text, "is not a readable safetensors file"),
        (damage_missing, "is not a readable safetensors file"),
        (damage_foreign, "does not hold the weights of this gloves_expert_flow: .* foreign, such as"),
        (
            damage_half_of_the_weights,
            "does not hold the weights of this gloves_expert_flow: .* missing and 0 are foreign",
        ),
        (damage_other_size, "holds weights of another size: .*dit.embed.weight"),
    ],
)
def test_weights_that_are_not_its_own_are_one_clear_line(expert, damage, message):
    damage(expert / WEIGHTS)
    with pytest.raises(ValueError, match=message) as error:
        load(expert)
    assert str(expert / WEIGHTS) in str(error.value) and "\n" not in str(error.value)


def test_an_agents_weights_are_foreign_to_an_expert_flow(expert, tmp_path):
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy")
    (expert / WEIGHTS).write_bytes((agent / WEIGHTS).read_bytes())
    with pytest.raises(ValueError, match=r"0 are missing and \d+ are foreign, such as 'ema\.module\.goal_encoder"):
        load(expert)


def test_saving_carries_the_calibration_of_the_weights(expert, tmp_path):
    calibrate(expert)
    policy = load(expert)
    policy.save_pretrained(tmp_path / "copy")
    original, copied = Calibration.load(expert), Calibration.load(tmp_path / "copy")
    assert (copied.weights, copied.episodes, copied.repo_id) == (original.weights, original.episodes, original.repo_id)
    assert same(dict(copied.scores), dict(original.scores))
    copied.check(weights_hash(load(tmp_path / "copy").state_dict()))


def test_an_uncalibrated_checkpoint_stays_uncalibrated(expert, tmp_path):
    load(expert).save_pretrained(tmp_path / "copy")
    assert not (tmp_path / "copy" / CALIBRATION_NAME).exists()


def test_training_on_leaves_the_old_calibration_behind_and_says_so_once(expert, tmp_path, caplog):
    calibrate(expert)
    policy = load(expert)
    with torch.no_grad():
        policy.network.dit.head.bias.add_(1e-3)
    policy.update()
    policy.save_pretrained(tmp_path / "first")
    policy.save_pretrained(tmp_path / "second")
    assert [record.message for record in caplog.records if record.levelno >= logging.WARNING] == [
        "the weights have changed, so their calibration is not saved: run gloves calibrate again"
    ]
    assert not any((tmp_path / name / CALIBRATION_NAME).exists() for name in ("first", "second"))
    assert Calibration.load(expert) is not None


def test_gathered_weights_are_what_counts(expert, tmp_path):
    """Under FSDP the caller hands over the whole state dict, and the policy's own is in shards."""
    calibrate(expert)
    policy = load(expert)
    whole = {key: value.clone() for key, value in policy.state_dict().items()}
    with torch.no_grad():
        policy.network.dit.head.bias.add_(1)
    policy.save_pretrained(tmp_path / "copy", state_dict=whole)
    copied = load(tmp_path / "copy").state_dict()
    assert copied.keys() == whole.keys() and all(torch.equal(copied[key], whole[key]) for key in whole)
    assert Calibration.load(tmp_path / "copy").weights == Calibration.load(expert).weights == weights_hash(copied)
