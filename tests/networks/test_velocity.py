import pytest
import torch
from torch import nn

from lerobot_gloves.flow import integrate
from lerobot_gloves.networks import VelocityNetwork
from tests.builders import awaken
from tests.gaussian import seeded

STATES = {"observation.environment_state": 3, "observation.state": 4}
CAMERAS = ("observation.images.left", "observation.images.right")
GOAL = ("observation.goal", 2)
B, T, A = 3, 5, 2


def make_network(cameras=(), goal=None, **options) -> VelocityNetwork:
    torch.manual_seed(0)
    small = {"context_dim": 8, "width": 16, "depth": 2, "heads": 2, "time_dim": 8, "dropout": 0.0}
    network = VelocityNetwork(A, states=STATES, cameras=cameras, goal=goal, **{**small, **options})
    awaken(network)
    return network.eval()


def observe(cameras=(), goal=None, rows: int = B):
    g = seeded(4)
    shapes = {key: (size,) for key, size in STATES.items()} | {camera: (3, 32, 32) for camera in cameras}
    if goal is not None:
        shapes[goal[0]] = (goal[1],)
    return {key: torch.randn(rows, *shape, generator=g) for key, shape in shapes.items()}


def noisy(rows: int = B):
    g = seeded(5)
    return torch.randn(rows, T, A, generator=g), torch.rand(rows, generator=g)


def test_states_are_one_token_the_goal_one_and_every_view_a_grid():
    network = make_network(CAMERAS, GOAL)
    assert network.encode(observe(CAMERAS, GOAL)).shape == (B, 1 + 2 * (2 * 2), 8)
    heads, keys = 2, 1 + 2 * (2 * 2) + 1
    assert network.bind(observe(CAMERAS, GOAL)).context[0][0].shape == (B, heads, keys, 16 // heads)


def test_every_observation_matters_and_the_views_are_not_interchangeable():
    network = make_network(CAMERAS, GOAL)
    observation, (x, t) = observe(CAMERAS, GOAL), noisy()
    velocity = network.bind(observation)(x, t)
    for key in observation:
        changed = network.bind({**observation, key: observation[key] + 1})(x, t)
        assert (changed - velocity).abs().max() > 1e-6, key
    left, right = CAMERAS
    swapped = network.bind({**observation, left: observation[right], right: observation[left]})(x, t)
    assert (swapped - velocity).abs().max() > 1e-6


def test_views_share_no_weights():
    first, second = make_network(CAMERAS).image_encoders
    shared = {id(p) for p in first.parameters()} & {id(p) for p in second.parameters()}
    assert not shared and not torch.equal(first.project.weight, second.project.weight)


def test_the_context_is_encoded_and_projected_once_however_often_the_velocity_is_evaluated():
    network = make_network(CAMERAS, GOAL)
    calls = []
    encoders = [network.state_encoder, network.goal_encoder, *network.image_encoders]
    projections = [block.cross.kv for block in network.dit.blocks]
    for module in [*encoders, *projections]:
        module.register_forward_hook(lambda *_: calls.append(1))
    velocity = network.bind(observe(CAMERAS, GOAL))
    bound = len(calls)
    assert bound == len(encoders) + len(projections)
    integrate(velocity, noisy()[0], steps=10)
    integrate(velocity, noisy(4 * B)[0], steps=3)
    assert len(calls) == bound
    assert velocity.evaluations == 10 + 4 * 3


def test_samples_share_their_context():
    network = make_network(goal=GOAL)
    observation = observe(goal=GOAL)
    x, t = noisy(2 * B)
    folded = network.bind(observation)(x, t)
    repeated = {key: value.repeat_interleave(2, dim=0) for key, value in observation.items()}
    torch.testing.assert_close(folded, network.bind(repeated)(x, t))


def test_guidance_extrapolates_from_the_null_through_the_conditional_field():
    network = make_network()
    with torch.no_grad():
        network.null.normal_()
    x, t = noisy(2 * B)
    conditional = network.bind(observe())(x, t)
    null = network.dit(x, t, network.dit.project(network.null.expand(B, 1, -1)))
    guided = network.bind(observe(), guidance=2.5)
    torch.testing.assert_close(guided(x, t), null + 2.5 * (conditional - null), rtol=1e-4, atol=1e-5)
    assert guided.evaluations == 2 * 2
    torch.testing.assert_close(network.bind(observe(), guidance=0.0)(x, t), null)


def test_with_a_goal_guidance_keeps_the_context_and_drops_the_goal_alone():
    network = make_network(goal=GOAL)
    x, t = noisy()
    observation = observe(goal=GOAL)
    without_goal = network.bind(observation, guidance=0.0)(x, t)
    other_goal = network.bind({**observation, GOAL[0]: observation[GOAL[0]] + 3}, guidance=0.0)(x, t)
    torch.testing.assert_close(other_goal, without_goal, rtol=0, atol=0)
    key = next(iter(STATES))
    assert (
        network.bind({**observation, key: observation[key] + 3}, guidance=0.0)(x, t) - without_goal
    ).abs().max() > 1e-6


def test_selected_contexts_are_those_rows():
    network = make_network()
    x, t = noisy()
    rows = torch.tensor([True, False, True])
    for guidance in (1.0, 3.0):
        velocity = network.bind(observe(), guidance=guidance)
        torch.testing.assert_close(velocity.select(rows)(x[rows], t[rows]), velocity(x, t)[rows])


def test_another_goal_of_the_same_observations_encodes_them_no_second_time():
    network = make_network(CAMERAS, GOAL)
    observation, (x, t) = observe(CAMERAS, GOAL), noisy()
    other = {**observation, GOAL[0]: observation[GOAL[0]] + 1}
    expected = network.bind(other)(x, t)
    tokens, calls = network.encode(observation), []
    for encoder in (network.state_encoder, *network.image_encoders):
        encoder.register_forward_hook(lambda *_: calls.append(1))
    torch.testing.assert_close(network.bind(other, tokens=tokens)(x, t), expected, rtol=0, atol=0)
    assert not calls


@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_fields_of_one_network_are_evaluated_by_one_call(guidance):
    network = make_network(goal=GOAL)
    observation, (x, t) = observe(goal=GOAL), noisy()
    one = network.bind(observation, guidance)
    other = network.bind({**observation, GOAL[0]: observation[GOAL[0]] + 1}, guidance)
    expected = torch.cat([one(x, t), other(x + 1, t), one(x - 1, t)])
    one.evaluations = other.evaluations = 0
    calls = []
    network.dit.register_forward_hook(lambda *_: calls.append(1))
    stacked = one.stack([other, one])(torch.cat([x, x + 1, x - 1]), t.repeat(3))
    torch.testing.assert_close(stacked, expected)
    assert len(calls) == 1
    per_call = 1 if guidance == 1.0 else 2
    assert (one.evaluations, other.evaluations) == (2 * per_call, per_call)


def test_fields_that_take_two_networks_or_two_guidances_are_not_stacked():
    network, other = make_network(), make_network()
    field = network.bind(observe())
    assert field.stack([other.bind(observe())]) is None
    assert field.stack([network.bind(observe(), guidance=2.0)]) is None
    assert field.stack([lambda x, t: x]) is None


def test_training_drops_whole_views_at_the_rate_asked_for():
    network = make_network(CAMERAS, context_dropout=0.0, visual_dropout=0.3)
    network.image_encoders = nn.ModuleList([nn.Identity(), nn.Identity()])  # the "images" are tokens already
    rows = 2000
    observation = observe(rows=rows) | {camera: torch.randn(rows, 4, 8) for camera in CAMERAS}
    torch.manual_seed(0)
    with torch.no_grad():
        tokens = network.train().encode(observation)
        kept = network.eval().encode(observation)
    views, reference = tokens[:, 1:].view(rows, 2, 4, -1), kept[:, 1:].view(rows, 2, 4, -1)
    dropped = (views == 0).all(dim=(2, 3))
    assert torch.equal(views[~dropped], reference[~dropped])  # whole or not at all
    assert torch.equal(tokens[:, 0], kept[:, 0])  # the state stays
    four_errors = 4 * (0.3 * 0.7 / rows) ** 0.5
    assert dropped.float().mean(dim=0).sub(0.3).abs().max() < four_errors
    assert abs(dropped.all(dim=1).float().mean() - 0.09) < four_errors  # each view by a draw of its own


@pytest.mark.parametrize("goal", [None, GOAL])
def test_training_replaces_the_context_or_only_the_goal_by_the_null(goal):
    network = make_network(goal=goal, context_dropout=0.2)
    rows = 600
    one = observe(goal=goal, rows=1)
    observation = {key: value.expand(rows, -1) for key, value in one.items()}
    x, t = (value[:1].expand(rows, *value.shape[1:]) for value in noisy())
    torch.manual_seed(0)
    with torch.no_grad():
        velocity = network.train().bind(observation)(x, t)
        conditional = network.eval().bind(one)(x[:1], t[:1])
        null = network.bind(one, guidance=0.0)(x[:1], t[:1])
    is_null = torch.isclose(velocity, null, atol=1e-5).all(dim=(1, 2))
    is_conditional = torch.isclose(velocity, conditional, atol=1e-5).all(dim=(1, 2))
    assert (is_null ^ is_conditional).all()
    assert abs(is_null.float().mean() - 0.2) < 4 * (0.2 * 0.8 / rows) ** 0.5


def test_the_null_learns():
    network = make_network(context_dropout=1.0).train()
    network.bind(observe())(*noisy()).square().sum().backward()
    assert network.null.grad.abs().max() > 0
    assert all(p.grad is None or not p.grad.any() for p in network.state_encoder.parameters())


def test_nothing_to_be_conditioned_on_is_refused():
    with pytest.raises(ValueError, match="neither a state vector nor a camera"):
        VelocityNetwork(A, states={})
