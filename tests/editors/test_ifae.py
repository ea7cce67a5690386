"""IFAE between Gaussian flows, where every step is affine and so is the edit.

With v(x, t) = mu + g (x - t mu) of `gaussian.py` for the agent (u) and the expert (e), a step of length h at time t
takes the edit a, the proposal a_u and fresh noise z to

    q = (1 - t) z + t a_u,    p = q + a - a_u,
    a' = a + h edit (v_p - v_q) + align ((q + (1 - t) v_q) - (p + (1 - t) v_p)).

Collecting terms, a' = A a + B a_u + C z + D: mean and covariance of (a, a_u) follow by three recursions.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lerobot_gloves.editors import IFAE, Reference
from lerobot_gloves.networks import VelocityNetwork
from tests.builders import awaken
from tests.gaussian import GaussianFlow, example_flow, seeded

N = 40_000
"""Chunks in a sample; each holds six independent coordinates."""


def flow(mean: float, std: float) -> GaussianFlow:
    return GaussianFlow(torch.full((3, 2), mean, dtype=torch.float64), torch.full((3, 2), std, dtype=torch.float64))


AGENT, EXPERT = flow(-0.3, 0.1), flow(0.3, 0.1)


@pytest.fixture
def agent() -> GaussianFlow:
    return example_flow()


@pytest.fixture
def expert(agent) -> GaussianFlow:
    return GaussianFlow(agent.mean.flip(0) + 0.3, 0.5 * agent.std.flip(1))


@pytest.fixture
def proposal(agent) -> torch.Tensor:
    return agent.mean + torch.randn(5, 3, 2, generator=seeded(0), dtype=torch.float64)


def velocity(x: np.ndarray, t: float, f: GaussianFlow) -> np.ndarray:
    mu, s = f.mean.numpy(), f.std.numpy()
    return mu + (t * s**2 - (1 - t)) / ((1 - t) ** 2 + t**2 * s**2) * (x - t * mu)


def algorithm(proposal, expert, agent, noise, editor: IFAE) -> np.ndarray:
    """Algorithm 1, line by line in numpy; `noise` is (K, B, T, A)."""
    source = proposal.numpy()
    chunk, grid = source.copy(), np.linspace(editor.start, 1, editor.steps + 1)
    for k, z in enumerate(noise.numpy()):
        t, dt = grid[k], grid[k + 1] - grid[k]
        q = (1 - t) * z + t * source
        p = q + (chunk - source)
        v_q, base = velocity(q, t, agent), velocity(p, t, agent)
        v_p = base + editor.guidance * (velocity(p, t, expert) - base)
        pull = (q + (1 - t) * v_q) - (p + (1 - t) * v_p)
        chunk = chunk + editor.edit * dt * (v_p - v_q) + editor.align * pull
    return chunk


def moments(agent: tuple[float, float], expert: tuple[float, float], editor: IFAE) -> tuple[float, float]:
    """Mean and variance of the edit of a_u ~ N(mean, std^2), guidance 1, by the recursions for A, B, C and D."""
    (mu_u, s_u), (mu_e, s_e) = agent, expert
    mean, variance, covariance = mu_u, s_u**2, s_u**2  # of a, of a, of (a, a_u)
    h = (1 - editor.start) / editor.steps
    for k in range(editor.steps):
        t = editor.start + k * h
        g_u, g_e = ((t * s**2 - (1 - t)) / ((1 - t) ** 2 + t**2 * s**2) for s in (s_u, s_e))
        # v_p - v_q and the pull, as coefficients of (a, a_u, z, 1); q = (0, t, 1 - t, 0), p = q + (1, -1, 0, 0).
        q, p = np.array([0, t, 1 - t, 0]), np.array([1, t - 1, 1 - t, 0])
        one = np.array([0, 0, 0, 1])
        v_q, v_p = mu_u * (1 - g_u * t) * one + g_u * q, mu_e * (1 - g_e * t) * one + g_e * p
        step = h * editor.edit * (v_p - v_q) + editor.align * ((q + (1 - t) * v_q) - (p + (1 - t) * v_p))
        a, b, c, d = step + np.array([1, 0, 0, 0])
        variance = a**2 * variance + 2 * a * b * covariance + b**2 * s_u**2 + c**2
        covariance = a * covariance + b * s_u**2
        mean = a * mean + b * mu_u + d
    return mean, variance


@pytest.mark.parametrize(
    "editor",
    [
        IFAE(),
        IFAE(steps=33, align=0.03),
        IFAE(steps=4, edit=1.7, align=0.3),
        IFAE(guidance=2.5),
        IFAE(guidance=0.0, align=0.05),
        IFAE(start=0.4, steps=7, guidance=1.3),
    ],
    ids=str,
)
def test_an_edit_is_algorithm_1(agent, expert, proposal, editor):
    generator = seeded(1)
    noise = [torch.randn(5, 3, 2, generator=generator, dtype=torch.float64) for _ in range(editor.steps)]
    edited = editor(proposal, Reference(expert, agent, generator=seeded(1)))
    expected = algorithm(proposal, expert, agent, torch.stack(noise), editor)
    np.testing.assert_allclose(edited.numpy(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("start", [0.0, 0.3])
@pytest.mark.parametrize("align", [0.0, 0.01])
@pytest.mark.parametrize("steps", [10, 33])
@pytest.mark.parametrize("expert", [(0.3, 0.1), (0.2, 0.25)])
def test_mean_and_variance_of_edits_are_those_of_the_affine_recursion(expert, steps, align, start):
    editor, source = IFAE(steps=steps, align=align, start=start), (-0.3, 0.1)
    proposals = flow(*source).sample(N, seeded(2))
    edited = editor(proposals, Reference(flow(*expert), flow(*source), generator=seeded(3)))
    mean, variance = moments(source, expert, editor)
    count = edited.numel()
    assert abs(edited.mean().item() - mean) < 4 * (variance / count) ** 0.5
    assert abs(edited.var().item() - variance) < 4 * variance * (2 / count) ** 0.5


@pytest.mark.parametrize(("align", "share"), [(0.0, 1.00), (0.01, 0.98), (0.1, 0.76)])
def test_share_of_the_gap_between_agent_and_expert_that_an_edit_closes(align, share):
    edited = IFAE(align=align)(AGENT.sample(N, seeded(2)), Reference(EXPERT, AGENT, generator=seeded(3)))
    assert (edited.mean().item() + 0.3) / 0.6 == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("steps", [10, 33])
def test_an_agent_that_is_the_expert_is_left_as_it_is(agent, proposal, steps, dtype):
    proposal, same = proposal.to(dtype), GaussianFlow(agent.mean.to(dtype), agent.std.to(dtype))
    edited = IFAE(steps=steps, align=0.0)(proposal, Reference(same, same, generator=seeded(1)))
    assert edited.dtype == dtype
    assert torch.equal(edited, proposal)


def test_without_edit_strength_nothing_is_edited(agent, expert, proposal):
    assert torch.equal(IFAE(edit=0.0, align=0.0)(proposal, Reference(expert, agent, generator=seeded(1))), proposal)


def test_from_the_beginning_a_shift_between_like_distributions_shifts_every_proposal_by_it():
    """Equal spreads: the first step, from t = 0, closes what it covers whatever the proposal; every edit is a shift."""
    proposals = AGENT.sample(100, seeded(2))
    moved = IFAE(align=0.0)(proposals, Reference(EXPERT, AGENT, generator=seeded(3))) - proposals
    torch.testing.assert_close(moved, torch.full_like(moved, 0.6), rtol=0, atol=1e-12)


def test_align_shortens_the_edit(agent, expert, proposal):
    moved = [
        (IFAE(align=align)(proposal, Reference(expert, agent, generator=seeded(4))) - proposal).norm().item()
        for align in (0.0, 0.01, 0.05, 0.1)
    ]
    assert moved == sorted(moved, reverse=True)


def bound_pair(rows: int):
    """Agent and expert of one network, and of two networks with the same weights."""
    networks = []
    for _ in range(2):
        torch.manual_seed(0)
        network = VelocityNetwork(
            2, states={"state": 3}, goal=("source", 2), context_dim=8, width=16, depth=1, heads=2, time_dim=8
        )
        awaken(network)
        networks.append(network.eval())
    state, label = torch.randn(rows, 3, generator=seeded(6)), torch.eye(2)[:, None].expand(2, rows, 2)
    one, other = networks

    def bind(network, i):
        return network.bind({"state": state, "source": label[i]})

    return (bind(one, 0), bind(one, 1)), (bind(one, 0), bind(other, 1))


@pytest.mark.parametrize(("guidance", "evaluations"), [(1.0, (10, 10)), (2.0, (20, 10))])
def test_one_network_is_evaluated_once_a_step_and_edits_as_two_do(guidance, evaluations):
    (agent, expert), (lone_agent, lone_expert) = bound_pair(5)
    proposal = torch.randn(5, 3, 2, generator=seeded(7))
    calls = []
    agent.dit.register_forward_hook(lambda module, inputs, output: calls.append(len(output)))
    edited = IFAE(guidance=guidance)(proposal, Reference(expert, agent, generator=seeded(8)))
    assert calls == 10 * [5 * sum(evaluations) // 10]
    assert (agent.evaluations, expert.evaluations) == evaluations
    apart = IFAE(guidance=guidance)(proposal, Reference(lone_expert, lone_agent, generator=seeded(8)))
    torch.testing.assert_close(edited, apart)
    assert (lone_agent.evaluations, lone_expert.evaluations) == evaluations
    assert not torch.allclose(edited, proposal, atol=1e-3)


def test_an_edit_needs_no_gradient_and_leaves_no_trace(proposal, agent):
    field = torch.nn.Linear(2, 2, dtype=torch.float64)
    before = proposal.clone()
    edited = IFAE()(proposal, Reference(lambda x, t: field(x), agent, generator=seeded(7)))
    assert not edited.requires_grad
    assert torch.equal(proposal, before)


def test_inference_mode_changes_nothing(agent, expert, proposal):
    expected = IFAE()(proposal, Reference(expert, agent, generator=seeded(8)))
    with torch.inference_mode():
        assert torch.equal(IFAE()(proposal, Reference(expert, agent, generator=seeded(8))), expected)


def test_without_an_agent_flow_there_is_no_difference_to_follow(expert, proposal):
    with pytest.raises(ValueError, match="IFAE: the reference has no agent flow"):
        IFAE()(proposal, Reference(expert))


def test_the_same_seed_edits_alike_and_another_one_otherwise(agent, expert, proposal):
    edits = [IFAE()(proposal, Reference(expert, agent, generator=seeded(seed))) for seed in (1, 1, 2)]
    assert torch.equal(edits[0], edits[1])
    assert not torch.equal(edits[0], edits[2])


def test_an_environment_is_edited_alike_in_any_batch(proposal):
    agents = example_flow(contexts=5)
    experts = GaussianFlow(agents.mean + 0.5, 0.5 * agents.std)
    batch = IFAE()(proposal, Reference(experts, agents, generator=[seeded(i) for i in range(5)]))
    for i in range(5):
        pair = [GaussianFlow(flows.mean[i], flows.std[i]) for flows in (experts, agents)]
        assert torch.equal(IFAE()(proposal[i : i + 1], Reference(*pair, generator=[seeded(i)])), batch[i : i + 1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"steps": 0}, "steps is 0, but must be at least 1"),
        ({"start": -0.1}, r"start is -0\.1, but must lie in \[0, 1\)"),
        ({"start": 1.0}, r"start is 1\.0"),
        ({"start": float("nan")}, "start is nan"),
        ({"align": -0.01}, r"align is -0\.01, but must lie in \[0, 0\.1\]"),
        ({"align": float("nan")}, "align is nan"),
        ({"align": 0.11}, r"align is 0\.11, but must lie in \[0, 0\.1\]: above edit .* the edit undoes itself"),
        ({"align": 0.04, "steps": 33}, r"must lie in \[0, 0\.0303\]"),
        ({"align": 0.06, "start": 0.5}, r"must lie in \[0, 0\.05\]"),
        ({"edit": 0.0}, r"must lie in \[0, 0\]"),
    ],
)
def test_bad_parameters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        IFAE(**arguments)


@pytest.mark.parametrize("arguments", [{"align": 0.1}, {"align": 0.07, "start": 0.3}, {"align": 0.2, "edit": 2.0}])
def test_align_may_reach_its_bound(arguments):
    """There the edit still goes from the agent's mean to the expert's, just shorter; above it is refused."""
    editor, source, target = IFAE(**arguments), (-0.3, 0.1), (0.3, 0.1)
    edited = editor(AGENT.sample(2000, seeded(2)), Reference(EXPERT, AGENT, generator=seeded(3))).mean().item()
    assert edited == pytest.approx(moments(source, target, editor)[0], abs=0.01)
    unaligned = moments(source, target, replace(editor, align=0.0))[0]
    assert source[0] + 0.2 < edited < unaligned - 0.05
    with pytest.raises(ValueError, match="the edit undoes itself"):
        replace(editor, align=1.01 * editor.align)
