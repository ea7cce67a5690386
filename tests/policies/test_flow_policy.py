import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from torchvision.models import ResNet18_Weights

from lerobot_gloves.flow import flow_matching_loss
from tests.builders import make_config, make_policy, observation

T = 6


def batch_of(rows: int, kind: str = "gloves_expert_flow", *, seed: int = 0) -> dict[str, torch.Tensor]:
    """Training data in which a chunk is a function of the state."""
    observed = observation(rows, seed=seed)
    if kind == "gloves_expert_flow":
        observed.pop("observation.goal")
    along = torch.linspace(-1, 1, T)[:, None]
    return {**observed, "action": observed["observation.state"][:, None, :2] + along}


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_flow_policy"])
def test_training_lowers_the_loss_and_samples_come_to_resemble_the_data(kind):
    torch.manual_seed(0)
    options = {"width": 32, "dropout": 0.0, "context_dropout": 0.0, "ema_decay": 0.9, "optimizer_lr": 5e-3}
    policy = make_policy(kind, **options)
    data, held_out = batch_of(64, kind), batch_of(64, kind, seed=1)
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())

    def loss(training: bool) -> float:
        torch.manual_seed(1)
        with torch.no_grad():
            return policy.train(training)(data)[0].item()

    def error() -> float:
        return (policy.predict_action_chunk(held_out) - held_out["action"]).square().mean().item()

    before, error_before = (loss(True), loss(False)), error()
    for _ in range(150):
        value, _ = policy.train()(data)
        optimizer.zero_grad()
        value.backward()
        optimizer.step()
        policy.update()
    assert loss(True) < 0.5 * before[0]
    assert loss(False) < 0.5 * before[1]
    assert loss(True) != loss(False)  # the trained and the averaged weights
    assert error() < 0.25 * error_before


def test_the_average_follows_the_papers_decay_after_a_warm_up():
    policy = make_policy("gloves_expert_flow", ema_decay=0.5)
    current, averaged = policy.network.dit.head.bias, policy.ema.module.dit.head.bias
    expected = None
    for k in range(12):
        with torch.no_grad():
            current.copy_(torch.tensor([k**2, -float(k)]))
        policy.update()
        # The first update copies; from the second on the n-th one keeps min(decay, (1 + n) / (10 + n)).
        decay = min(0.5, (1 + k) / (10 + k))
        value = [k**2, -float(k)]
        expected = value if k == 0 else [decay * e + (1 - decay) * v for e, v in zip(expected, value, strict=True)]
    torch.testing.assert_close(averaged, torch.tensor(expected))
    assert (1 + 11) / (10 + 11) > 0.5  # the warm-up was over


def test_inference_uses_the_average_and_training_does_not():
    policy = make_policy("gloves_expert_flow")
    data = batch_of(4)
    chunk = policy.predict_action_chunk(data)
    training = _loss(policy.train(), data)
    evaluating = _loss(policy.eval(), data)
    with torch.no_grad():
        for parameter in policy.network.parameters():
            parameter.add_(1.0)
    policy.reset()
    policy._episodes._next = 0
    assert torch.equal(policy.predict_action_chunk(data), chunk)
    assert _loss(policy.eval(), data) == evaluating
    assert _loss(policy.train(), data) != training


def _loss(policy, data) -> float:
    torch.manual_seed(0)
    with torch.no_grad():
        return policy(data)[0].item()


def test_the_loss_is_flow_matching_over_several_draws_for_each_item():
    policy = make_policy("gloves_expert_flow", samples_per_item=5)
    data = batch_of(4)
    torch.manual_seed(3)
    per_item, _ = policy(data, reduction="none")
    torch.manual_seed(3)
    mean, _ = policy(data)
    torch.manual_seed(3)
    expected = flow_matching_loss(policy.ema.module.bind(data), data["action"], samples=5)
    torch.testing.assert_close(per_item, expected, rtol=0, atol=0)
    torch.testing.assert_close(mean, expected.mean())


def test_items_are_encoded_once_for_all_their_draws():
    policy = make_policy("gloves_expert_flow", samples_per_item=8).train()
    rows = []
    policy.network.state_encoder.register_forward_hook(lambda *call: rows.append(("encoder", len(call[-1]))))
    policy.network.dit.register_forward_hook(lambda *call: rows.append(("dit", len(call[-1]))))
    policy(batch_of(4))
    assert rows == [("encoder", 4), ("dit", 32)]


def test_padding_beyond_an_episodes_end_does_not_count():
    policy = make_policy("gloves_expert_flow")
    data = batch_of(3)
    data["action_is_pad"] = torch.zeros(3, T, dtype=torch.bool)
    data["action_is_pad"][0, 4:] = True
    data["action_is_pad"][2] = True
    torch.manual_seed(0)
    velocity = policy.ema.module.bind(data)
    rows = velocity(torch.zeros(3, T, 2), torch.zeros(3))
    policy.ema.module.bind = lambda *_, **__: lambda x, t: rows.repeat_interleave(8, dim=0)  # nothing leaks through v
    torch.manual_seed(0)
    first, _ = policy(data, reduction="none")
    data["action"][data["action_is_pad"]] = 1e6
    torch.manual_seed(0)
    second, _ = policy(data, reduction="none")
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    assert first[2] == 0 and first[:2].min() > 0


def test_a_state_policy_has_one_rate():
    assert [group.keys() for group in make_policy("gloves_expert_flow").get_optim_params()] == [{"params"}]


def test_weights_that_cannot_be_fetched_name_the_option(monkeypatch):
    def unreachable(*_, **__):
        raise OSError("offline")

    monkeypatch.setattr(ResNet18_Weights, "get_state_dict", unreachable)
    config = make_config(
        "gloves_expert_flow", "pixels_agent_pos", pretrained_backbone_weights="ResNet18_Weights.IMAGENET1K_V1"
    )
    from lerobot.policies import get_policy_class

    with pytest.raises(OSError, match=r"--policy\.pretrained_backbone_weights=null"):
        get_policy_class("gloves_expert_flow")(config)


def test_draws_belong_to_an_episode_whatever_batch_it_runs_in():
    rows = {key: value[:1].expand(4, *value.shape[1:]) for key, value in observation(1).items()}
    policy = make_policy("gloves_flow_policy")
    together = policy.predict_action_chunk(rows)
    again = make_policy("gloves_flow_policy")
    pairs = []
    for _ in range(2):
        again.reset()
        pairs.append(again.predict_action_chunk({key: value[:2] for key, value in rows.items()}))
    torch.testing.assert_close(torch.cat(pairs), together, rtol=1e-5, atol=1e-6)
    distances = torch.cdist(together.flatten(1), together.flatten(1))
    assert distances[~torch.eye(4, dtype=torch.bool)].min() > 0.1  # an episode, other draws


def test_reduced_precision_changes_no_draw_and_little_else():
    """`--policy.use_amp=true`: the network's layers are rounded, noise and integration are not."""
    seen = observation(3)
    exact = make_policy("gloves_flow_policy").predict_action_chunk(seen)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rounded = make_policy("gloves_flow_policy").predict_action_chunk(seen)
    assert rounded.dtype == torch.float32
    assert not torch.equal(rounded, exact)
    torch.testing.assert_close(rounded, exact, rtol=0, atol=0.05)


def test_draws_come_from_the_policys_seed_and_from_nothing_else():
    data = observation(2)
    torch.manual_seed(0)
    state = torch.get_rng_state()
    chunk = make_policy("gloves_flow_policy").predict_action_chunk(data)
    assert torch.equal(torch.get_rng_state(), state)
    torch.manual_seed(1)
    assert torch.equal(make_policy("gloves_flow_policy").predict_action_chunk(data), chunk)
    other = make_policy("gloves_flow_policy")
    other.config.seed = 1
    assert not torch.allclose(other.predict_action_chunk(data), chunk, atol=1e-2)


def test_a_chunk_is_used_up_before_the_next_is_sampled():
    policy, twin = make_policy("gloves_flow_policy"), make_policy("gloves_flow_policy")
    first, second = observation(2), observation(2, seed=1)
    actions = [policy.select_action(first) for _ in range(3)] + [policy.select_action(second) for _ in range(3)]
    chunks = [twin.predict_action_chunk(first), twin.predict_action_chunk(second)]
    expected = [*chunks[0].unbind(1)[:4], *chunks[1].unbind(1)[:2]]  # n_action_steps is 4
    torch.testing.assert_close(torch.stack(actions), torch.stack(expected), rtol=0, atol=0)


def test_a_new_episode_drops_what_is_left_of_the_old_ones_chunk():
    policy = make_policy("gloves_flow_policy")
    data = observation(2)
    first = policy.select_action(data)
    policy.select_action(data)
    policy.reset()
    after = policy.select_action(data)
    twin = make_policy("gloves_flow_policy")
    torch.testing.assert_close(first, twin.select_action(data), rtol=0, atol=0)
    twin.reset()
    torch.testing.assert_close(after, twin.select_action(data), rtol=0, atol=0)


def test_guidance_is_part_of_inference():
    data = observation(2)
    plain = make_policy("gloves_flow_policy").predict_action_chunk(data)
    guided = make_policy("gloves_flow_policy", guidance=4.0)
    assert not torch.allclose(guided.predict_action_chunk(data), plain, atol=1e-3)
    assert guided.velocity(data).guidance == 4.0


@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
def test_the_goal_is_the_agents_and_never_the_experts(obs_type):
    data = observation(2, obs_type)
    other = {**data, "observation.goal": data["observation.goal"] + 1}
    for kind, reads_it in [("gloves_flow_policy", True), ("gloves_expert_flow", False)]:
        policy = make_policy(kind, obs_type)
        assert ("observation.goal" in policy.config.input_features) == reads_it
        chunk = policy.predict_action_chunk(data)
        policy.reset()
        policy._episodes._next = 0
        assert torch.equal(policy.predict_action_chunk(other), chunk) != reads_it


def test_features_that_are_not_enough_are_one_clear_line():
    state = {"observation.state": PolicyFeature(FeatureType.STATE, (4,))}
    goal = {"observation.goal": PolicyFeature(FeatureType.STATE, (9,))}
    cases = [
        ("gloves_flow_policy", {"input_features": state}, "no 'observation.goal', only observation.state"),
        ("gloves_flow_policy", {"input_features": goal}, "nothing to be conditioned on.* holds only observation.goal"),
        ("gloves_expert_flow", {"input_features": goal}, "nothing to be conditioned on.* holds only observation.goal"),
        ("gloves_expert_flow", {"input_features": {}}, "nothing to be conditioned on.* holds only nothing"),
        ("gloves_expert_flow", {"output_features": {}}, "the data holds no 'action', only nothing"),
    ]
    for kind, features, message in cases:
        with pytest.raises(ValueError, match=message) as error:
            make_policy(kind, **features)
        assert str(error.value).startswith(kind) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_action_steps": 7}, "n_action_steps is 7, but must lie between 1 and chunk_size, 6"),
        ({"n_action_steps": 0}, "n_action_steps is 0"),
        ({"samples_per_item": 0}, "samples_per_item is 0, but must be at least 1"),
        ({"depth": 0}, "depth is 0, but must be at least 1"),
        ({"context_dropout": 1.0}, "context_dropout is 1.0, but must lie in"),
        ({"ema_decay": -2.0}, "ema_decay is -2.0, but must lie in"),
        ({"width": 30, "heads": 4}, "width is 30, which 4 heads cannot share"),
        ({"time_dim": 7}, "time_dim is 7, but must be even"),
    ],
)
def test_impossible_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        make_config("gloves_expert_flow", **options)
