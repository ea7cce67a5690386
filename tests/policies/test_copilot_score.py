"""The copilot scored by its own correction: as a gate, and inside editors."""

import json
import math

import pytest
import torch

from lerobot_gloves.editors import FPAS, Copilot
from lerobot_gloves.flow import endpoint, times
from lerobot_gloves.generators import spawn
from lerobot_gloves.networks.copilot import told
from lerobot_gloves.perturbations import Laggy
from lerobot_gloves.scores import CorrectionScore, Joint, LikelihoodScore, ReverseScore
from tests.builders import FLOW, calibrate, make_policy, observation, save_policy, wrap

B, T, A, H = 3, FLOW["chunk_size"], 2, 2


@pytest.fixture(scope="module")
def policy():
    return make_policy("gloves_copilot")


@pytest.fixture
def chunks():
    """Two last proposals and the one to be scored, (B, H + 1, T, A)."""
    return torch.randn(B, H + 1, T, A, generator=torch.Generator().manual_seed(1))


def seen(policy):
    return {key: value for key, value in observation(B).items() if key in policy.config.input_features}


def distances(policy, chunks, length=None):
    """By hand: how far the mean given all of `chunks` lies from the last of them."""
    there = torch.ones(chunks.shape[:2], dtype=torch.bool)
    nothing, start = torch.zeros_like(chunks[:, -1]), times(0.0, chunks[:, -1])
    field = told(policy.averaged.bind(seen(policy)), chunks, there)
    return (endpoint(nothing, start, field(nothing, start)) - chunks[:, -1])[:, :length].norm(dim=-1).mean(dim=-1)


def test_it_is_told_the_last_proposals_and_is_one_evaluation(policy, chunks):
    bound = policy.bind(seen(policy), chunks[:, :-1])
    torch.testing.assert_close(bound.score(chunks[:, -1], CorrectionScore()), distances(policy, chunks))
    assert bound.evaluations == 1
    short = bound.score(chunks[:, -1], CorrectionScore(), length=2)
    torch.testing.assert_close(short, distances(policy, chunks, length=2))
    told_less = policy.bind(seen(policy)).score(chunks[:, -1], CorrectionScore())
    assert (told_less - distances(policy, chunks)).abs().max() > 1e-3
    some = torch.tensor([True, False, True])
    torch.testing.assert_close(
        bound.select(some).score(chunks[some, -1], CorrectionScore()), distances(policy, chunks)[some]
    )


def test_what_repeats_the_last_proposal_to_the_bit_is_infinite(policy, chunks):
    chunks[1, -1], chunks[2, -1] = chunks[1, -2], chunks[2, -2] + 1e-6
    found = policy.bind(seen(policy), chunks[:, :-1]).score(chunks[:, -1], CorrectionScore())
    assert found.isinf().tolist() == [False, True, False]
    # Nothing was proposed before: nothing is repeated.
    assert policy.bind(seen(policy)).score(chunks[:, -1], CorrectionScore()).isfinite().all()


def test_in_the_copilots_edit_the_mean_is_score_as_well(policy, chunks):
    bound, proposal, calls = policy.bind(seen(policy), chunks[:, :-1]), chunks[:, -1], []
    apart = distances(policy, chunks)
    free = bound.edit(proposal, Copilot(limit=-1))
    hook = policy.averaged.dit.register_forward_hook(lambda *_: calls.append(1))
    before, middle = bound.evaluations, apart.median().item() + 1e-6
    edited = bound.edit(proposal, Copilot(limit=0.0), score=CorrectionScore(), threshold=middle)
    hook.remove()
    torch.testing.assert_close(edited, torch.where((apart > middle)[:, None, None], free, proposal))
    assert len(calls) == 1 and bound.evaluations == before + 1


def test_an_edit_of_what_was_scored_does_not_ask_for_the_mean_again(policy, chunks):
    proposal, editor = chunks[:, -1], Copilot(limit=0.0)
    some, middle = torch.tensor([True, False, True]), distances(policy, chunks).median().item() + 1e-6
    alone = policy.bind(seen(policy), chunks[:, :-1]).edit(proposal, editor, score=CorrectionScore(), threshold=middle)
    bound, calls = policy.bind(seen(policy), chunks[:, :-1]), []
    bound.score(proposal, CorrectionScore())
    hook = policy.averaged.dit.register_forward_hook(lambda *_: calls.append(1))
    part = bound.select(some)
    for edited, expected in (
        (bound.edit(proposal, editor, score=CorrectionScore(), threshold=middle), alone),
        (part.edit(proposal[some], editor, score=CorrectionScore(), threshold=middle), alone[some]),
    ):
        torch.testing.assert_close(edited, expected)
    assert not calls and (bound.evaluations, part.evaluations) == (1, 0)
    # Of others it does.
    other = proposal + 1.0
    fresh = policy.bind(seen(policy), chunks[:, :-1]).edit(other, Copilot(limit=-1))
    torch.testing.assert_close(bound.edit(other, Copilot(limit=-1)), fresh)
    hook.remove()
    assert bound.evaluations == 2


@pytest.mark.parametrize("other", [ReverseScore(), LikelihoodScore(steps=3)])
def test_in_the_copilots_edit_two_scores_turn_away_what_either_does(policy, chunks, other):
    bound, proposal = policy.bind(seen(policy), chunks[:, :-1]), chunks[:, -1]
    apart = torch.stack([bound.score(proposal, score) for score in (other, CorrectionScore())])
    bounds = tuple(one.sort().values[1].item() + 1e-4 for one in apart)  # each turns one of three away
    free = bound.edit(proposal, Copilot(limit=-1))
    calls = []
    hook = policy.averaged.dit.register_forward_hook(lambda *_: calls.append(1))
    edited = bound.edit(proposal, Copilot(limit=0.0), score=Joint((other, CorrectionScore()), bounds), threshold=0.0)
    hook.remove()
    above = (apart > torch.tensor(bounds)[:, None]).any(dim=0)
    assert 0 < above.sum() < B
    torch.testing.assert_close(edited, torch.where(above[:, None, None], free, proposal))
    if isinstance(other, ReverseScore):
        assert len(calls) == 1, "score, score and mean are one call"


def test_a_likelihood_in_the_copilots_edit_is_the_one_by_itself(policy, chunks):
    """Its divergence needs a gradient, which what was evaluated before does not have."""
    bound, proposal = policy.bind(seen(policy), chunks[:, :-1]), chunks[:, -1]
    score = LikelihoodScore(steps=2)
    apart = bound.score(proposal, score)
    for threshold, left in ((apart.max().item() + 1e-3, True), (apart.min().item() - 1e-3, False)):
        edited = bound.edit(proposal, Copilot(limit=0.0), score=score, threshold=threshold)
        assert torch.equal(edited, proposal) == left


def test_fpas_searches_by_it_also_where_the_proposal_is_a_repetition(policy, chunks):
    chunks[0, -1] = chunks[0, -2]
    bound, generator = policy.bind(seen(policy), chunks[:, :-1]), spawn(0, B, stream="editor")
    edited = bound.edit(
        chunks[:, -1], FPAS(iterations=5, align=0.0), score=CorrectionScore(), threshold=0.0, generator=generator
    )
    assert edited.isfinite().all() and (edited != chunks[:, -1]).flatten(1).any(dim=1).all()


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    folder = tmp_path_factory.mktemp("copilot")
    agent = save_policy(folder / "agent", "gloves_flow_policy", chunk_size=4)
    table = torch.arange(1.0, 100.0).expand(T, -1).clone()
    loose, strict = (
        calibrate(
            save_policy(folder / name, "gloves_copilot", seed=7),
            scores={"correction": scale * table, "reverse:steps=1": 1e6 * table},
        )
        for name, scale in (("loose", 1e3), ("strict", 1e-6))
    )
    return agent, loose, strict


def test_under_the_gate_a_replay_is_turned_away_however_good_the_first_was(checkpoints, tmp_path):
    agent, copilot, _ = checkpoints
    options = {"gate": True, "alpha": 0.02, "score": "correction", "log": tmp_path / "log.jsonl"}
    policy = wrap(agent, adapter=copilot, perturbation=Laggy(p=1.0), **options)
    edited = []
    for step in range(8):
        with torch.inference_mode():
            policy.select_action(observation(B, seed=step))
        if step in (0, 4):
            edited.append(policy.correction.edited.tolist())
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    scores = [line["score"] for line in lines]
    assert all(map(math.isfinite, scores[:B])) and scores[B:] == [math.inf] * B
    assert edited == [[False] * B, [True] * B]
    assert [line["p_value"] for line in lines] == [1.0] * B + [0.01] * B
    assert "Infinity" not in (tmp_path / "log.jsonl").read_text()


@pytest.mark.parametrize("method", ["feeg:steps=2", "fpas:iterations=2", "copilot", "copilot:limit=-1", "none"])
@pytest.mark.parametrize("score", ["correction", "reverse:steps=1+correction"])
@pytest.mark.parametrize("gate", [True, False])
def test_every_editor_goes_with_it(checkpoints, method, score, gate):
    agent, _, copilot = checkpoints
    policy = wrap(agent, adapter=copilot, method=method, score=score, gate=gate, alpha=0.9)
    with torch.inference_mode():
        actions = torch.stack([policy.select_action(observation(B, seed=step)) for step in range(8)])
    assert actions.isfinite().all()
    assert policy.statistics()["chunks"] == 2 * B
    assert (policy.statistics()["intervention_rate"] > 0) == (method != "none")
