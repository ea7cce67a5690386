"""The copilot: what it is told, what it learns, how far it edits."""

import math
from itertools import pairwise

import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import get_policy_class
from lerobot.scripts.lerobot_train import train

from lerobot_gloves.editors import Copilot, Reference
from lerobot_gloves.networks.copilot import repeats, told
from lerobot_gloves.scores import ReverseScore
from tests.builders import (
    FLOW,
    calibrate,
    load,
    make_config,
    make_policy,
    observation,
    save_policy,
    training_options,
    wrap,
    write_dataset,
)
from tests.policies.test_training_command import LAST

B, T, A, H = 3, FLOW["chunk_size"], 2, 2


@pytest.fixture(scope="module")
def policy():
    return make_policy("gloves_copilot")


@pytest.fixture
def batch():
    generator = torch.Generator().manual_seed(1)
    states = {
        "observation.state": torch.randn(B, 4, generator=generator),
        "observation.environment_state": torch.randn(B, 12, generator=generator),
    }
    action = torch.randn(B, H * 4 + T, A, generator=generator)  # a decision every four actions
    return {**states, "action": action, "action_is_pad": torch.zeros(B, H * 4 + T, dtype=torch.bool)}


def test_the_agents_last_decisions_are_the_experts_chunks_there(policy, batch):
    assert policy.config.action_delta_indices == list(range(-8, 6))
    batch["action_is_pad"][1, :6] = True  # its episode began two actions ago: of the decisions there was this one
    batch["action_is_pad"][2, :4] = True
    chunks, there = policy.decisions(batch["action"], batch["action_is_pad"])
    assert there.tolist() == [[True, True, True], [False, False, True], [False, True, True]]
    assert torch.equal(chunks[0], torch.stack([batch["action"][0, i : i + 6] for i in (0, 4, 8)]))
    assert torch.equal(chunks[1], batch["action"][1, 8:].expand(3, -1, -1))
    assert torch.equal(chunks[2], torch.stack([batch["action"][2, i : i + 6] for i in (4, 4, 8)]))


def test_what_lies_before_an_episode_may_be_of_another(policy, batch):
    chunks, there = policy.decisions(batch["action"], batch["action_is_pad"])
    there[1, :2], there[2, 0] = False, False
    found, told_of = policy.among_strangers(chunks.repeat(200, 1, 1, 1), there.repeat(200, 1))
    assert torch.equal(found[told_of & there.repeat(200, 1)], chunks.repeat(200, 1, 1, 1)[there.repeat(200, 1)])
    mixed = told_of.view(200, B, -1)
    assert mixed[:, 0].all() and mixed[:, 1, 0].float().mean().item() == pytest.approx(0.5, abs=0.12)
    assert torch.equal(mixed[:, 1, 0], mixed[:, 1, 1]), "the whole of it or nothing"
    sources = {
        int((chunks[:, 0] == one).flatten(1).all(dim=1).int().argmax()) for one in found[1::B, 0][mixed[:, 1, 0]]
    }
    assert sources == {0, 1, 2}


def test_told_nothing_it_is_the_experts_flow_and_told_more_it_is_another(policy, batch):
    expert = policy.averaged.bind(batch)
    generator = torch.Generator().manual_seed(2)
    x, t = torch.randn(B, T, A, generator=generator), torch.rand(B, generator=generator)
    proposals = torch.randn(B, H + 1, T, A, generator=generator)

    def field(*there: bool):
        return told(expert, proposals, torch.tensor(there).expand(B, -1))

    torch.testing.assert_close(field(False, False, False)(x, t), expert(x, t))
    fields = [expert, field(False, False, True), field(False, True, True), field(True, True, True)]
    seen = [one(x, t) for one in fields]
    assert all((one - other).abs().max() > 1e-3 for one, other in pairwise(seen))
    some = torch.tensor([True, False, True])
    torch.testing.assert_close(fields[-1].select(some)(x[some], t[some]), seen[-1][some])


def test_where_contexts_are_doubted_a_share_of_what_is_told_proposals_sees_another_items(batch, monkeypatch):
    shares = {"context_swap": 0.6, "alone_share": 0.5, "mean_share": 0.5, "faults": ["replay"], "healthy": 0.5}
    new = make_policy("gloves_copilot", **shares, samples_per_item=4000).train()
    new.witnesses.doubted.fill_(True)
    own, seen = new.network.encode(batch), {}
    bind = new.network.bind

    def spied_bind(observation, tokens):
        seen["tokens"] = tokens
        return bind(observation, tokens=tokens)

    def spied_told(bound, proposals, there):
        seen["alone"] = ~there[:, -1]
        seen["again"] = (proposals[:, -1] == proposals[:, -2]).all(dim=2).all(dim=1)
        return told(bound, proposals, there)

    monkeypatch.setattr(new.network, "bind", spied_bind)
    monkeypatch.setattr("lerobot_policy_gloves.gloves_copilot.modeling_gloves_copilot.told", spied_told)
    new(batch)
    is_of = (seen["tokens"][:, None] == own[None]).flatten(2).all(dim=2).float().view(B, 4000, B)
    alone, again = (seen[name].view(B, 4000) for name in ("alone", "again"))
    for item, own in enumerate(torch.eye(B)):  # an item may meet itself
        assert torch.equal(is_of[item][alone[item]].mean(dim=0), own), "the expert's flow sees its own"
        assert torch.equal(is_of[item][~alone[item] & again[item]].mean(dim=0), own), "a repetition tells nothing"
        others = is_of[item][~alone[item] & ~again[item]].mean(dim=0)
        torch.testing.assert_close(others, 0.4 * own + 0.6 / B, rtol=0, atol=0.06)


def test_a_repetition_is_the_last_proposal_to_the_bit_where_there_was_one():
    one, other = torch.zeros(T, A), torch.zeros(T, A)
    other[-1, -1] = 1e-7
    proposals = torch.stack([torch.stack(pair) for pair in ((one, one), (one, other), (one, one))])
    there = torch.tensor([[True, True], [True, True], [False, True]])
    assert repeats(proposals, there).tolist() == [[False, True], [False, False], [False, False]]


def test_a_field_of_zero_has_the_loss_of_what_each_draw_asks_for(batch):
    """Of the mean: the action itself, squared. Of a flow: the action and noise of variance 1."""
    batch["action_is_pad"][0, -2:] = True
    action, mask = batch["action"][:, -T:], ~batch["action_is_pad"][:, -T:]
    of_actions = (action.square().mean(-1) * mask).sum(-1) / mask.sum(-1)
    for share, expected in ((1.0, of_actions), (0.0, of_actions + 1)):
        config = make_config("gloves_copilot", mean_share=share, alone_share=0.0, samples_per_item=400)
        new = get_policy_class("gloves_copilot")(config).train()  # its last layer is zero
        loss, _ = new(batch, reduction="none")
        torch.testing.assert_close(loss, expected, rtol=0.0 if share else 0.1, atol=1e-5 if share else 0.0)


def test_it_learns_to_trust_a_healthy_agent_and_to_undo_a_fault(batch):
    """The expert's chunk is anything at all: only the proposal tells what it is."""
    new = make_policy(
        "gloves_copilot", faults=["scale"], healthy=1.0, mean_share=1.0, alone_share=0.0, width=32
    ).train()
    optimiser = torch.optim.Adam(new.network.parameters(), lr=3e-3)
    generator = torch.Generator().manual_seed(0)
    many = {key: value.repeat_interleave(20, dim=0) for key, value in batch.items()}
    for _ in range(200):
        many["action"] = torch.randn(many["action"].shape, generator=generator)
        loss, _ = new(many)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert loss < 0.15, "1 without a look at the proposal"


def test_an_edit_is_the_mean_and_limited_where_the_proposal_is_admitted_and_new():
    proposal = torch.zeros(4, T, A)
    mean = torch.zeros(4, T, A)
    mean[:, :, 0] = torch.tensor([0.3, 2.0, 2.0, 2.0])[:, None]
    reference = Reference(
        expert=lambda x, t: x,
        posterior=lambda x, t: mean - x + t[:, None, None],
        repeated=torch.tensor([False, False, False, True]),
        score=lambda field, chunk, length: torch.tensor([1.0, 1.0, 3.0, 1.0]),
        threshold=2.0,
        length=4,
    )
    edited = Copilot(limit=0.5)(proposal, reference)
    assert edited[:, 0, 0].tolist() == pytest.approx([0.3, 0.5, 2.0, 2.0])
    assert torch.equal(Copilot(limit=-1)(proposal, reference), mean)
    with pytest.raises(ValueError, match="copilot needs an adapter that reads proposals"):
        Copilot()(proposal, Reference(expert=None))


def test_proposals_far_from_the_data_enter_by_their_logarithm(policy, batch):
    far = torch.tensor([0.0, 0.03, 3 * math.sinh(1.0), -3 * math.sinh(4.0)])
    proposals = far[:, None].expand(B, H + 1, -1, A)[:, :, :4]
    there = torch.tensor([False, True, True]).expand(B, -1)
    beside = told(policy.averaged.bind(batch), proposals, there).beside.view(B, 4, H + 1, A + 2)
    assert beside[0, :, 2, 0].tolist() == pytest.approx([0.0, 0.03, 3.0, -12.0], rel=1e-4)
    assert beside[..., -2].unique(dim=1).squeeze().tolist() == [[0.0, 1.0, 1.0]] * B, "which are told"
    assert beside[..., -1].unique(dim=1).squeeze().tolist() == [[0.0, 0.0, 1.0]] * B, "which repeat one that is"
    assert not beside[:, :, 0].any(), "what is not told is zero"


def test_the_score_and_the_mean_are_one_call_of_the_network(policy, batch):
    observation = {key: value for key, value in batch.items() if key in policy.config.input_features}
    proposal = batch["action"][:, -T:]
    bound, calls = policy.bind(observation, proposal[:, None] + 1), []
    free = bound.edit(proposal, Copilot(limit=-1))
    policy.averaged.dit.register_forward_hook(lambda *_: calls.append(1))
    for steps, times in ((1, 1), (5, 5)):
        calls.clear()
        score = ReverseScore(steps=steps)
        apart = bound.score(proposal, score)
        expected = torch.where((apart > apart.median())[:, None, None], free, proposal)
        calls.clear()
        edited = bound.edit(proposal, Copilot(limit=0.0), score=score, threshold=apart.median().item() + 1e-6)
        torch.testing.assert_close(edited, expected)
        assert len(calls) == times


def test_what_it_does_where_nobody_says_is_in_its_configuration(tmp_path, checkpoints):
    named = {"method": "feeg:start=0.5,steps=2", "gate_score": "reverse:steps=2"}
    scores = {"reverse:steps=2": torch.zeros(T, 99)}  # a gate on these stops everything
    adapter = calibrate(save_policy(tmp_path / "copilot", "gloves_copilot", **named), scores=scores)
    told = {"method": "feeg:start=0.5,steps=2", "gate": True, "score": "reverse:steps=2"}
    said, unsaid = (wrap(checkpoints.agent, adapter=adapter, **how) for how in (told, {"gate": True}))
    actions = []
    for policy in (said, unsaid):
        torch.manual_seed(0)
        actions.append(policy.select_action(observation(2)))
    assert torch.equal(*actions) and torch.equal(said.correction.score, unsaid.correction.score)
    assert unsaid.correction.edited.all() and not torch.equal(actions[0], unsaid.correction.proposal[:, 0])


@pytest.mark.parametrize(("told", "edited"), [({}, True), ({"alpha": 0.2}, False)])
def test_the_level_of_its_gate_is_in_its_configuration(told, edited, tmp_path, checkpoints):
    adapter = save_policy(tmp_path / "copilot", "gloves_copilot", gate_alpha=0.5, gate_score="reverse:steps=1")
    # Of 9 scores, 3 are above any: a p-value is (1 + 3) / (1 + 9).
    scores = torch.tensor([0.0] * 6 + [1e9] * 3).expand(T, -1).contiguous()
    calibrate(adapter, scores={"reverse:steps=1": scores})
    policy = wrap(checkpoints.agent, adapter=adapter, gate=True, **told)
    policy.select_action(observation(2))
    assert policy.correction.p_value.tolist() == pytest.approx([0.4] * 2)
    assert policy.correction.edited.tolist() == [edited] * 2


@pytest.mark.parametrize(("option", "line"), [("method", "unknown method 'fly'"), ("gate_score", "unknown gate_score")])
def test_what_it_cannot_do_is_no_default_of_it(option, line):
    with pytest.raises(ValueError, match=line):
        make_policy("gloves_copilot", **{option: "fly"})


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"history": -1}, "history is -1, but must not be negative"),
        ({"decision_every": 7}, "decision_every is 7, but must lie between 1 and 6"),
        ({"strangers": 1.5}, "strangers is 1.5, but must lie in"),
        ({"context_swap": -0.1}, "context_swap is -0.1, but must lie in"),
        ({"gate_alpha": 1.5}, "gate_alpha is 1.5, but must lie in"),
        ({"faults": ["laggy"]}, "there is no fault 'laggy': choose from held, "),
        (
            {"mean_share": 0.7, "alone_share": 0.4},
            "mean_share and alone_share are 0.7 and 0.4, but must share one",
        ),
    ],
)
def test_wrong_settings_are_one_clear_line(options, line):
    with pytest.raises(ValueError, match=line):
        make_config("gloves_copilot", **options)


def test_it_is_trained_by_lerobots_command_and_is_the_expert_by_itself(tmp_path, typed):
    write_dataset(tmp_path / "data")
    typed(*training_options("gloves_copilot", tmp_path / "data", tmp_path / "run", steps=2), "--policy.history=2")
    train()
    trained, _ = load(tmp_path / "run" / LAST / "pretrained_model")
    assert set(trained.config.input_features) == {"observation.state", "observation.environment_state"}
    assert trained.predict_action_chunk(observation(2)).shape == (2, T, A)
    stats = LeRobotDataset("me/tiny", root=tmp_path / "data").meta.stats["action"]
    expected = torch.as_tensor(-stats["mean"] / stats["std"], dtype=torch.float32)
    torch.testing.assert_close(trained.zero, expected)  # standing still, as the processors normalise it
