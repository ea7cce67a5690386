"""The wrapper's gate with several scores, and by episode."""

import json
from dataclasses import replace

import pytest
import torch

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.scores import Joint, ResidualScore, ReverseScore
from tests.builders import FLOW, calibrate, observation, save_policy, wrap

T = FLOW["chunk_size"]
BOTH = "reverse:steps=1+residual:times=5,pairs=1,seed=0"
REVERSE, RESIDUAL = BOTH.split("+")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gate")


@pytest.fixture(scope="module")
def agent(folder):
    return save_policy(folder / "agent", "gloves_flow_policy", chunk_size=4)


@pytest.fixture(scope="module")
def found(folder, agent):
    """The two scores (2, 4) of what the agent proposes to four observations, as an adapter logs them one by one."""
    adapter, scores = save_policy(folder / "bare", "gloves_expert_flow", seed=7), []
    for name in (REVERSE, RESIDUAL):
        policy = wrap(agent, adapter=adapter, method="none", score=name, log=folder / f"{name[:3]}.jsonl")
        policy.select_action(observation(4))
        scores.append(policy.correction.score)
    return torch.stack(scores)


def adapter_of(folder, name, tables, **options):
    scores = {key: table.expand(T, -1).clone() for key, table in tables.items()}
    return calibrate(save_policy(folder / name, "gloves_expert_flow", seed=7), scores=scores, **options)


def test_a_chunk_passes_if_both_scores_let_it_and_the_log_says_by_how_much(folder, agent, found):
    """Calibrated by 39 equal scores, a chunk's p-value is 1 up to them and 1/40 above."""
    middles = found.sort(dim=1).values[:, 1:3].mean(dim=1)
    adapter = adapter_of(folder, "both", {REVERSE: middles[0].expand(39), RESIDUAL: middles[1].expand(39)})
    policy = wrap(agent, adapter=adapter, gate=True, alpha=0.06, score=BOTH, log=folder / "both.jsonl")
    policy.select_action(observation(4))
    above = found > middles[:, None]
    assert above.any(dim=0).tolist() == policy.correction.edited.tolist()
    expected = torch.where(above.any(dim=0), 2 / 40, 1.0)
    torch.testing.assert_close(policy.correction.p_value.float(), expected)
    excess = torch.maximum(found[0] - middles[0], found[1] - middles[1])
    lines = [json.loads(line) for line in (folder / "both.jsonl").read_text().splitlines()]
    torch.testing.assert_close(torch.tensor([line["score"] for line in lines]), excess, rtol=1e-4, atol=1e-4)
    each = torch.tensor([[line["scores"][name] for line in lines] for name in (REVERSE, RESIDUAL)])
    torch.testing.assert_close(each, found, rtol=1e-4, atol=1e-4)
    # A single score's 1/40 is below 0.06 / 2, and above 0.04 / 2: that level lets all pass, and so is refused.
    with pytest.raises(ValueError, match=r"alpha is 0\.04, shared by 2 scores, but with 39 .* on at least 49 chunks"):
        wrap(agent, adapter=adapter, gate=True, alpha=0.04, score=BOTH)


def test_an_editor_aims_below_both_thresholds(folder, agent, found):
    tables = {REVERSE: torch.arange(1.0, 100.0), RESIDUAL: torch.arange(1.0, 100.0) / 10}
    adapter = adapter_of(folder, "aims", tables)
    corrector = wrap(agent, adapter=adapter, alpha=0.1, score=BOTH)._corrector
    # 5 % of 100 ranks for each: the fifth largest of 99 has 5 + 1 ranks at or above it, the largest p-value above 0.05.
    assert corrector.gate.aim(4) == (Joint((ReverseScore(), ResidualScore()), (95.0, 9.5)), 0.0)
    corrector = wrap(agent, adapter=adapter, alpha=0.1)._corrector
    assert corrector.gate.aim(4) == (ReverseScore(), 90.0)


def test_a_copilots_gate_asks_its_correction_and_its_editor_the_first_score(folder, agent):
    tables = {name: torch.arange(1.0, 100.0).expand(T, -1).clone() for name in (REVERSE, "correction")}
    adapter = calibrate(save_policy(folder / "copilot", "gloves_copilot"), scores=tables)
    named = [wrap(agent, adapter=adapter, **gate)._corrector.gate.names for gate in ({}, {"gate": True})]
    assert named == [[REVERSE], ["correction"]]
    (named,) = wrap(agent, adapter=adapter, gate=True, score=REVERSE)._corrector.gate.names
    assert named == REVERSE


def test_by_episode_the_threshold_is_of_the_worst_chunks(folder, agent):
    """Of 19 episodes with scores i and 100 + i the worst are 101 to 119."""
    table = torch.cat([torch.arange(1.0, 20.0), 100 + torch.arange(1.0, 20.0)])
    of = (*range(19), *range(19))
    adapter = adapter_of(folder, "episodes", {REVERSE: table}, episode_of=of)
    by_chunk, by_episode = (
        wrap(agent, adapter=adapter, gate=True, alpha=0.1, **options)._corrector.gate.test(4)
        for options in ({}, {"alpha_of": "episodes"})
    )
    assert by_chunk.thresholds == (117.0,), "3.9 of 39 ranks"
    assert by_episode.thresholds == (118.0,), "2 of 20 ranks"
    assert by_episode.p_value(torch.tensor([[50.0, 118.0]])).tolist() == [1.0, 0.15]
    with pytest.raises(ValueError, match=r"alpha is 0\.04, but with 19 .* calibrate on at least 24 episodes"):
        wrap(agent, adapter=adapter, gate=True, alpha=0.04, alpha_of="episodes")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"score": BOTH}, "--policy.score=.* needs a calibration, and .* has none: run gloves calibrate"),
        ({"alpha_of": "chunk"}, "unknown alpha_of 'chunk': choose from chunks, episodes"),
        ({"score": "reverse+revers"}, "unknown score 'revers': choose from "),
    ],
)
def test_what_cannot_be_is_one_line(folder, agent, found, options, line):
    with pytest.raises(ValueError, match=line) as error:
        wrap(agent, adapter=folder / "bare", **options)
    assert "\n" not in str(error.value)


def test_calibrated_by_infinite_scores_it_would_let_all_pass(folder, agent):
    table = torch.cat([torch.arange(1.0, 97.0), torch.full((10,), torch.inf)])
    adapter = adapter_of(folder, "infinite", {REVERSE: table})
    with pytest.raises(ValueError, match="of 10 in 106 calibration chunks reverse:steps=1 is infinite: the gate would"):
        wrap(agent, adapter=adapter, gate=True, alpha=0.05)
    assert wrap(agent, adapter=adapter, gate=True, alpha=0.2)._corrector.gate.test(4).thresholds[0] < 97


def test_who_only_writes_scores_down_needs_no_calibrated_length(folder, agent):
    adapter = adapter_of(folder, "long", {REVERSE: torch.arange(1.0, 100.0)})
    calibration = Calibration.load(adapter)
    replace(calibration, scores={REVERSE: calibration.scores[REVERSE][:1]}, lengths=(5,)).save(adapter)
    policy = wrap(agent, adapter=adapter, method="none", log=folder / "long.jsonl")
    policy.select_action(observation(2))
    assert policy.correction.score.isfinite().all() and policy.correction.p_value is None
    with pytest.raises(ValueError, match="the calibration holds lengths 5, but a proposal has 4 actions: run gloves"):
        wrap(agent, adapter=adapter, gate=True).select_action(observation(2))
