import json

import pytest
import torch

from lerobot_gloves.adapter import pad
from lerobot_gloves.editors import FEEG, FPAS, Reference
from lerobot_gloves.generators import spawn
from lerobot_gloves.scores import ReverseScore
from tests.builders import calibrate, load, observation, save_policy, wrap

T = 6
"""Chunk size of the adapter."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("checkpoints")


@pytest.fixture(scope="module")
def agent(folder):
    """Executes all of its chunks of 4 actions."""
    return save_policy(folder / "agent", "gloves_flow_policy", chunk_size=4)


@pytest.fixture(scope="module")
def adapter(folder):
    return save_policy(folder / "adapter", "gloves_expert_flow", seed=7)


def act(policy, batch, steps: int) -> torch.Tensor:
    """Actions (B, steps, A) under an observation that stays."""
    with torch.inference_mode():
        return torch.stack([policy.select_action(batch) for _ in range(steps)], dim=1)


class Spy:
    """Notes what a corrector is given and gives back."""

    def __init__(self, policy):
        self.policy, self.corrector, self.calls = policy, policy._corrector, []
        policy._corrector = self

    def __getattr__(self, name):
        return getattr(self.corrector, name)

    def __call__(self, batch, proposal, generators, history):
        correction = self.corrector(batch, proposal, generators, history)
        self.calls.append((self.policy._step, batch, proposal.clone(), correction))
        return correction


def by_hand(adapter, batch, proposal, score=ReverseScore()):
    """The adapter bound to observations, the normalised padded proposals and their scores."""
    policy, (preprocess, postprocess) = load(adapter)
    inputs = {key: value for key, value in batch.items() if key in policy.config.input_features}
    prepared = preprocess({**inputs, "action": pad(proposal, T)})
    bound = policy.bind(prepared)
    length = proposal.shape[1]
    return bound, prepared["action"], bound.score(prepared["action"], score, length=length), postprocess


def test_without_a_gate_every_proposal_is_edited_as_the_editor_says(agent, adapter):
    policy = wrap(agent, adapter=adapter, method="feeg:start=0.3,steps=4", seed=5)
    batch = observation(3)
    proposal = act(wrap(agent), batch, 4)
    executed = act(policy, batch, 4)
    bound, chunk, _, postprocess = by_hand(adapter, batch, proposal)
    for row in range(3):
        generator = spawn(5, 1, first_episode=row, stream="editor")
        alone = bound.select(torch.arange(3) == row)
        edited = FEEG(start=0.3, steps=4)(chunk[row : row + 1], Reference(alone.expert, generator=generator))
        torch.testing.assert_close(executed[row : row + 1], postprocess(edited)[:, :4], rtol=1e-4, atol=1e-7)
    assert (executed != proposal).all()


def test_the_gate_admits_bit_for_bit_and_edits_the_rest(folder, agent, adapter):
    batch = observation(4)
    proposal = act(wrap(agent), batch, 4)
    bound, chunk, scores, postprocess = by_hand(adapter, batch, proposal)
    middle = scores.sort().values[1:3].mean()
    # 99 calibration scores in the middle: p-values are 100 / 100 below it and 1 / 100 above.
    gated = calibrate(
        save_policy(folder / "gated", "gloves_expert_flow", seed=7),
        scores={"reverse:steps=1": middle.expand(T, 99).clone()},
    )
    policy = wrap(agent, adapter=gated, gate=True, method="feeg:steps=3")
    spy = Spy(policy)
    executed = act(policy, batch, 4)
    turned_away = scores > middle
    assert turned_away.sum() == 2
    assert torch.equal(executed[~turned_away], proposal[~turned_away])
    assert (executed[turned_away] != proposal[turned_away]).all()
    [(_, _, _, correction)] = spy.calls
    assert torch.equal(correction.edited, turned_away)
    torch.testing.assert_close(correction.score, scores)
    torch.testing.assert_close(correction.p_value.float(), torch.where(turned_away, 0.01, 1.0))
    assert correction.evaluations.tolist() == [4 if edited else 1 for edited in turned_away.tolist()]
    after = by_hand(adapter, batch, executed)[1]
    moved = (after - chunk)[:, :4].norm(dim=-1).mean(dim=-1)
    torch.testing.assert_close(correction.distance, moved * turned_away, rtol=1e-3, atol=1e-5)
    assert policy.statistics()["intervention_rate"] == 0.5
    assert policy.statistics()["distance"] == pytest.approx(correction.distance.mean().item())
    # An edited row is what it would have been alone.
    row = int(turned_away.nonzero()[0])
    generator = spawn(0, 1, first_episode=row, stream="editor")
    expert = bound.select(torch.arange(4) == row).expert
    alone = FEEG(steps=3)(chunk[row : row + 1], Reference(expert, generator=generator))
    torch.testing.assert_close(executed[row : row + 1], postprocess(alone)[:, :4], rtol=1e-4, atol=1e-7)


def test_fpas_searches_below_the_gates_threshold(folder, agent):
    gated = calibrate(
        save_policy(folder / "fpas", "gloves_expert_flow", seed=7),
        scores={"reverse:steps=1": torch.full((T, 99), 0.25)},
    )
    batch = observation(2)
    proposal = act(wrap(agent), batch, 4)
    executed = act(wrap(agent, adapter=gated, gate=True, method="fpas:iterations=3,sigma=0.5"), batch, 4)
    bound, chunk, scores, postprocess = by_hand(gated, batch, proposal)
    assert (scores > 0.25).all()
    editor = FPAS(iterations=3, sigma=0.5)
    # Only the 4 actions that there are count.
    generators = spawn(0, 2, stream="editor")
    reference = Reference(bound.expert, score=ReverseScore(), threshold=0.25, length=4, generator=generators)
    edited = editor(chunk, reference)
    torch.testing.assert_close(executed, postprocess(edited)[:, :4], rtol=1e-4, atol=1e-7)


def test_long_chunks_are_edited_window_by_window_under_the_observation_of_the_moment(folder, adapter):
    long = save_policy(folder / "long", "act", chunk_size=25, n_action_steps=25)
    policy = wrap(long, adapter=adapter, method="feeg:steps=2")
    spy, observations = Spy(policy), [observation(2, seed=step) for step in range(27)]
    for batch in observations:
        with torch.inference_mode():
            policy.select_action(batch)
    # 25 = 6 + 6 + 6 + 6 + 1; at step 25 the agent plans anew.
    assert [(step, proposal.shape[1]) for step, _, proposal, _ in spy.calls] == [
        (0, 6), (6, 6), (12, 6), (18, 6), (24, 1), (25, 6)
    ]  # fmt: skip
    for step, batch, _, _ in spy.calls:
        assert all(torch.equal(batch[key], observations[step][key]) for key in batch)
    plan = act(wrap(long), observations[0], 25)
    torch.testing.assert_close(torch.cat([call[2] for call in spy.calls[:5]], dim=1), plan, rtol=0, atol=0)
    assert policy.statistics()["chunks"] == 2 * 6


def test_short_chunks_are_padded_by_their_last_action_and_scored_by_their_length(folder, agent):
    table = torch.arange(1.0, T + 1)[:, None] * 1e6 * torch.ones(T, 19)  # every length is admitted, by another value
    gated = calibrate(save_policy(folder / "short", "gloves_expert_flow", seed=7), scores={"reverse:steps=1": table})
    policy = wrap(agent, adapter=gated, gate=True)
    spy = Spy(policy)
    act(policy, observation(2), 9)
    assert [(step, call.shape[1]) for step, _, call, _ in spy.calls] == [(0, 4), (4, 4), (8, 4)]
    assert policy._corrector.gate.test(4).gates[0].scores.tolist() == [4e6] * 19
    for _, batch, proposal, correction in spy.calls:
        torch.testing.assert_close(correction.score, by_hand(gated, batch, proposal)[2])


def test_edits_belong_to_an_episode_whatever_batch_it_runs_in(agent, adapter):
    batch = {key: value[:1].expand(4, *value.shape[1:]) for key, value in observation(1).items()}
    together = act(wrap(agent, adapter=adapter), batch, 10)
    policy, pairs = wrap(agent, adapter=adapter), []
    for _ in range(2):
        policy.reset()
        pairs.append(act(policy, {key: value[:2] for key, value in batch.items()}, 10))
    torch.testing.assert_close(torch.cat(pairs), together, rtol=1e-4, atol=1e-7)
    assert not torch.allclose(together[0], together[1], rtol=1e-2)


def test_edits_draw_from_the_wrappers_seed_alone(agent, adapter):
    batch = observation(2)
    state = torch.get_rng_state()
    first = act(wrap(agent, adapter=adapter, seed=3), batch, 4)
    torch.manual_seed(99)
    assert torch.equal(act(wrap(agent, adapter=adapter, seed=3), batch, 4), first)
    assert not torch.allclose(act(wrap(agent, adapter=adapter, seed=4), batch, 4), first, rtol=1e-2)
    torch.set_rng_state(state)
    act(wrap(agent, adapter=adapter), batch, 4)
    drawn = torch.get_rng_state()
    torch.set_rng_state(state)
    act(wrap(agent), batch, 4)
    assert torch.equal(torch.get_rng_state(), drawn)  # the agent's noise is as without an adapter


@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
def test_feeg_gives_the_same_inside_inference_mode(folder, obs_type):
    agent = save_policy(folder / f"agent_{obs_type}", "gloves_flow_policy", obs_type)
    adapter = save_policy(folder / f"adapter_{obs_type}", "gloves_expert_flow", obs_type, seed=7)
    batch = observation(2, obs_type)
    outside = wrap(agent, adapter=adapter)
    expected = torch.stack([outside.select_action(batch) for _ in range(9)], dim=1)
    with torch.inference_mode():
        made_inside = {key: value.clone() for key, value in batch.items()}
    inside = act(wrap(agent, adapter=adapter), made_inside, 9)
    assert torch.equal(inside, expected)


def test_feeg_from_the_end_changes_nothing_but_rounding(agent, adapter):
    batch = observation(2)
    kept = act(wrap(agent, adapter=adapter, method="feeg:start=1"), batch, 9)
    torch.testing.assert_close(kept, act(wrap(agent), batch, 9), rtol=1e-4, atol=1e-8)


def test_the_adapter_may_call_observations_by_other_names(folder, agent, adapter):
    names = {"observation.environment_state": "observation.pillars", "observation.state": "observation.tip"}
    policy, _ = load(adapter)
    config = policy.config
    config.input_features = {names[key]: value for key, value in config.input_features.items()}
    renamed = save_policy(folder / "renamed", "gloves_expert_flow", seed=7, input_features=config.input_features)
    batch = observation(2)
    # Statistics are drawn in the features' order, which is the same; so the two adapters are.
    expected = act(wrap(agent, adapter=adapter), batch, 4)
    torch.testing.assert_close(act(wrap(agent, adapter=renamed, adapter_rename_map=names), batch, 4), expected)


def test_one_line_of_json_a_chunk(tmp_path, folder, agent):
    gated = calibrate(
        save_policy(folder / "logged", "gloves_expert_flow", seed=7),
        scores={"reverse:steps=1": torch.full((T, 9), 5.0)},
    )
    log = tmp_path / "below" / "what.jsonl"
    policy = wrap(agent, adapter=gated, gate=True, alpha=0.5, method="feeg:steps=3", log=log)
    spy = Spy(policy)
    for batches in range(2):
        policy.reset()
        for step in range(6):
            with torch.inference_mode():
                policy.select_action(observation(2, seed=10 * batches + step))
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(line["episode"], line["step"], line["length"]) for line in lines] == [
        (episode, step, 4) for first in (0, 2) for step in (0, 4) for episode in (first, first + 1)
    ]
    corrections = [correction for *_, correction in spy.calls for _ in range(2)]
    for i, (line, correction) in enumerate(zip(lines, corrections, strict=True)):
        row = i % 2
        assert line["score"] == correction.score[row].item()
        # 9 calibration scores of 5: (1 + 9) / 10 up to 5, else (1 + 0) / 10.
        assert line["p_value"] == (1.0 if line["score"] <= 5 else 0.1)
        assert line["edited"] == (line["p_value"] <= 0.5) == bool(correction.edited[row])
        assert line["evaluations"] == (4 if line["edited"] else 1)
        assert (line["distance"] > 0) == line["edited"]
        assert line["milliseconds"] > 0
    totals = policy.statistics()
    assert totals["chunks"] == len(lines)
    for key, name in [("intervention_rate", "edited"), ("distance", "distance"), ("evaluations", "evaluations")]:
        assert totals[key] == pytest.approx(sum(line[name] for line in lines) / len(lines))


def test_scores_are_logged_without_a_gate_or_a_calibration(tmp_path, agent, adapter):
    policy = wrap(agent, adapter=adapter, method="none", score="reverse:steps=3", log=tmp_path / "log")
    spy = Spy(policy)
    act(policy, observation(1), 1)
    [line] = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    _, batch, proposal, _ = spy.calls[0]
    assert line["score"] == pytest.approx(by_hand(adapter, batch, proposal, ReverseScore(steps=3))[2].item(), rel=1e-5)
    assert (line["p_value"], line["edited"], line["evaluations"]) == (None, False, 3)


def test_an_uncalibrated_score_is_no_matter_without_a_gate(folder, agent, adapter):
    calibrated = calibrate(save_policy(folder / "other_score", "gloves_expert_flow", seed=7))
    policy, batch = wrap(agent, adapter=calibrated, score="reverse:steps=3"), observation(2)
    assert policy._corrector.gate.test(1) is None
    edited = act(policy, batch, 4)
    assert torch.equal(edited, act(wrap(agent, adapter=adapter), batch, 4))  # the same weights, never calibrated
    assert policy.statistics()["intervention_rate"] == 1


def test_what_happens_after_an_episodes_end_does_not_count(tmp_path, agent, adapter):
    """In a batch, environments whose episode is over repeat their last observation."""
    policy = wrap(agent, adapter=adapter, log=tmp_path / "log")
    last = observation(3, seed=6)
    for step in range(14):
        batch = observation(3, seed=step)
        if step > 6:
            batch = {key: torch.cat([value[:1], last[key][1:2], value[2:]]) for key, value in batch.items()}
        with torch.inference_mode():
            policy.select_action(batch)
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    steps = {episode: [line["step"] for line in lines if line["episode"] == episode] for episode in range(3)}
    assert steps == {0: [0, 4, 8, 12], 1: [0, 4], 2: [0, 4, 8, 12]}
