"""What image encoders start from, how fast they learn, and what they compute in."""

import pytest
import torch
from lerobot.policies import get_policy_class
from torch import nn
from torchvision.models import ResNet18_Weights, resnet18

from tests.builders import CAMERA, make_config, make_policy, observation, save_policy

IMAGENET = "ResNet18_Weights.IMAGENET1K_V1"
PIXELS = "pixels_agent_pos"


@pytest.fixture
def offline_imagenet(monkeypatch):
    """torchvision's file of weights, in reach."""
    torch.manual_seed(3)
    weights = resnet18(weights=None).state_dict()
    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", lambda *_, **__: weights)
    return weights


@pytest.fixture
def seen(tmp_path):
    """A flow that has seen the camera, whose average differs from what was trained last."""
    policy = make_policy("gloves_expert_flow", PIXELS, seed=7)
    with torch.no_grad():
        policy.network.image_encoders[0].backbone[0].weight.add_(1.0)
    return save_policy(tmp_path / "seen", "gloves_expert_flow", policy=policy)


def first_convolution(policy) -> torch.Tensor:
    return policy.network.image_encoders[0].backbone[0].weight


def step(policy) -> None:
    """One of training, by the policy's own optimiser."""
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    data = {**observation(2, PIXELS), "action": torch.randn(2, policy.config.chunk_size, 2)}
    loss, _ = policy.train()(data)
    loss.backward()
    optimizer.step()
    policy.update()


def test_encoders_from_none_are_normalised_by_groups_and_learn_at_the_full_rate():
    policy = make_policy("gloves_expert_flow", PIXELS)
    assert policy.config.backbone_norm == "group"
    norms = [m for m in policy.network.image_encoders[0].backbone.modules() if "Norm" in type(m).__name__]
    assert len(norms) == 15 and all(isinstance(norm, nn.GroupNorm) for norm in norms)
    assert [group.keys() for group in policy.get_optim_params()] == [{"params"}]


def test_pretrained_encoders_keep_their_batch_norm_and_learn_at_a_tenth_of_the_rate(offline_imagenet):
    policy = make_policy("gloves_expert_flow", PIXELS, pretrained_backbone_weights=IMAGENET)
    assert policy.config.backbone_norm == "frozen_batch"
    assert torch.equal(first_convolution(policy), offline_imagenet["conv1.weight"])
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    rest, backbone = optimizer.param_groups
    assert (rest["lr"], backbone["lr"]) == (3e-4, pytest.approx(0.1 * 3e-4))
    assert rest["weight_decay"] == backbone["weight_decay"] == 1e-3
    assert {id(p) for p in backbone["params"]} == {
        id(p) for name, p in policy.named_parameters() if name.startswith("network.") and ".backbone." in name
    }
    trained = [id(p) for group in optimizer.param_groups for p in group["params"]]
    assert sorted(trained) == sorted(id(p) for p in policy.network.parameters())  # each once, no average
    assert any(
        "project" in name for name, p in policy.network.named_parameters() if id(p) in {id(q) for q in rest["params"]}
    )


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_copilot", "gloves_flow_policy", "csa_assist"])
def test_encoders_start_from_those_of_a_flow_that_has_seen_the_cameras(kind, seen):
    options = {"context_dim": 8, "width": 16, "depth": 1, "heads": 2, "time_dim": 16}
    policy = make_policy(kind, PIXELS, pretrained_backbone_weights=str(seen), **options)
    source = get_policy_class("gloves_expert_flow").from_pretrained(seen)
    theirs = source.averaged.image_encoders[0].backbone.state_dict()
    assert not torch.equal(theirs["0.weight"], first_convolution(source))
    for network in (policy.network, policy.averaged):
        ours = network.image_encoders[0].backbone.state_dict()
        assert ours.keys() == theirs.keys() and all(torch.equal(ours[key], theirs[key]) for key in ours)


def test_a_rate_of_none_leaves_them_as_they_are_and_the_rest_learns(seen):
    policy = make_policy("gloves_expert_flow", PIXELS, pretrained_backbone_weights=str(seen), optimizer_lr_backbone=0.0)
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    step(policy)
    changed = {name for name, value in policy.state_dict().items() if not torch.equal(value, before[name])}
    assert not any(".backbone." in name for name in changed)
    assert any(".project." in name for name in changed) and any(".dit." in name for name in changed)


def test_a_student_has_its_teachers_encoders_and_leaves_them_alone_like_it(tmp_path, seen):
    options = {"chunk_size": 6, "width": 16, "depth": 1, "heads": 2, "time_dim": 16, "context_dim": 16, "levels": 4}
    options |= {"optimizer_lr_backbone": 0.0, "n_action_steps": 4}
    made = make_policy("csa_assist", PIXELS, pretrained_backbone_weights=str(seen), **options)
    teacher = save_policy(tmp_path / "teacher", "csa_assist", policy=made)
    student = make_policy("csa_assist", PIXELS, stage="student", teacher=str(teacher), **options)
    assert student.config.backbone_norm == "group"
    theirs = made.averaged.image_encoders[0].backbone[0].weight
    assert torch.equal(first_convolution(student), theirs)
    step(student)
    assert torch.equal(first_convolution(student), theirs)
    again = get_policy_class("csa_assist").from_pretrained(save_policy(tmp_path / "s", "csa_assist", policy=student))
    assert torch.equal(first_convolution(again), theirs)


def test_half_the_bits_give_the_same_tokens_within_their_precision():
    whole = make_policy("gloves_expert_flow", PIXELS)
    half = make_policy("gloves_expert_flow", PIXELS, backbone_dtype="bfloat16")
    half.load_state_dict(whole.state_dict())
    data = observation(2, PIXELS)
    with torch.no_grad():
        tokens, exact = half.averaged.encode(data), whole.averaged.encode(data)
    assert tokens.dtype == torch.float32 and not torch.equal(tokens, exact)
    torch.testing.assert_close(tokens, exact, rtol=0.05, atol=0.05 * exact.std().item())
    assert half.predict_action_chunk(data).dtype == torch.float32


# --- Bad input ---


def test_a_flow_of_other_cameras_is_one_line(seen):
    config = make_config("gloves_expert_flow", PIXELS, pretrained_backbone_weights=str(seen))
    config.input_features["observation.images.wrist"] = config.input_features.pop(CAMERA)
    with pytest.raises(ValueError, match=r"has not seen observation\.images\.wrist: start from a flow of") as error:
        get_policy_class("gloves_expert_flow")(config)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("of_state", [True, False])
def test_what_has_no_encoders_of_ours_is_one_line(tmp_path, of_state):
    kind, obs_type = ("gloves_expert_flow", "state") if of_state else ("act", PIXELS)
    folder = save_policy(tmp_path / kind, kind, obs_type)
    message = "has not seen" if of_state else "is of type 'act', whose image encoders"
    with pytest.raises(ValueError, match=message):
        make_policy("gloves_expert_flow", PIXELS, pretrained_backbone_weights=str(folder))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pretrained_backbone_weights": "no/such/folder"}, "neither one of torchvision's, .*nor a checkpoint's"),
        ({"backbone_norm": "batch"}, "no norm 'batch': choose from frozen_batch, group"),
        ({"backbone_dtype": "int8"}, "does not compute in 'int8': choose from float32, bfloat16"),
    ],
)
def test_other_bad_settings_are_one_line(options, message):
    with pytest.raises(ValueError, match=message) as error:
        make_policy("gloves_expert_flow", PIXELS, **options)
    assert "\n" not in str(error.value)


def test_another_norm_than_the_weights_have_is_refused(seen):
    with pytest.raises(ValueError, match=r"normalises by 'group', but --policy\.backbone_norm is 'frozen_batch'"):
        make_policy("gloves_expert_flow", PIXELS, pretrained_backbone_weights=str(seen), backbone_norm="frozen_batch")
