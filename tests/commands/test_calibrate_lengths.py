"""`gloves calibrate` for some lengths of proposals, and the gate where a proposal is between two of them."""

import logging

import pytest
import torch

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.scoring import default_lengths
from lerobot_gloves.commands.calibrate import calibrate
from lerobot_gloves.generators import spawn
from lerobot_gloves.networks.dit import DiT
from lerobot_gloves.scores import Joint, Leading
from tests.builders import FLOW, observation, save_policy, wrap, write_dataset

T = FLOW["chunk_size"]
BOTH = "reverse:steps=1+residual:times=5,pairs=1,seed=0"


def run(typed, adapter, root, *options: str) -> Calibration:
    own = ["--policy.device=cpu", "--dataset.repo_id=me/tiny", f"--dataset.root={root}", "--stride=1"]
    typed(f"--policy.path={adapter}", *own, *options)
    return calibrate()


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=3, length=9).root


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("agent") / "agent", "act")


def test_a_proposal_between_two_lengths_is_judged_as_a_shorter_one_would_be(typed, data, agent, tmp_path, caplog):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)
    every = run(typed, adapter, data, "--scores=[reverse, residual]")
    assert every.lengths == tuple(range(1, T + 1))
    whole = wrap(agent, adapter=adapter, gate=True, alpha=0.2, score=BOTH)._corrector
    some = run(typed, adapter, data, "--scores=[reverse, residual]", "--lengths=[5, 2]")
    assert some.lengths == (2, 5)
    for name, table in some.scores.items():  # chunks of 5 actions begin in 5 frames of an episode's 9, of 6 in 4
        assert table.shape == (2, 3 * 5)
        for row, length in enumerate(some.lengths):
            among = torch.isclose(table[row][:, None], every.scores[name][length - 1], rtol=1e-4, atol=1e-5)
            assert among.any(dim=0).all()
    corrector = wrap(agent, adapter=adapter, gate=True, alpha=0.2, score=BOTH)._corrector
    seen, proposal = observation(4), 0.004 * torch.randn(4, T, 2, generator=torch.Generator().manual_seed(0))
    for length, judged in ((2, 2), (4, 2), (5, 5), (T, 5)):
        found = corrector(seen, proposal[:, :length], spawn(0, 4, stream="editor"))
        alone = whole(seen, proposal[:, :judged], spawn(0, 4, stream="editor"))
        for name in some.scores:
            torch.testing.assert_close(found.each[name], alone.each[name], rtol=1e-5, atol=1e-6)
        rank = [(some.of(name, judged) >= one[:, None]).sum(dim=1) for name, one in found.each.items()]
        expected = (2 * (1 + torch.stack(rank).amin(dim=0)) / 16).clamp(max=1)
        torch.testing.assert_close(found.p_value.float(), expected)
        assert found.action.shape[1] == length, "all of it is corrected"
    warned = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING and r.name.endswith("gloves.gate")]
    told = "gloves: proposals of %d actions are judged by their first %d: calibrate that length by --lengths"
    assert warned == [told % (4, 2), told % (T, 5)]
    with pytest.raises(ValueError, match=r"lengths 2, 5, but a proposal has 1 actions: run .* --lengths='\[1\]'"):
        corrector(seen, proposal[:, :1], spawn(0, 4, stream="editor"))


def test_an_editor_aims_below_the_threshold_of_what_is_judged(typed, data, agent, tmp_path):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7)
    calibration = run(typed, adapter, data, "--scores=[reverse, residual]", "--lengths=[2, 6]")
    gate = wrap(agent, adapter=adapter, gate=True, alpha=0.2, method="fpas")._corrector.gate
    score, threshold = gate.aim(4)
    # A fifth of 13 ranks are two and a half: the second largest of the twelve is turned away no more.
    assert threshold == calibration.of("reverse:steps=1", 2).sort().values[-2].item()
    bound = wrap(agent, adapter=adapter)._corrector.adapter.bind(observation(3)).expert
    chunk = torch.randn(3, T, 2, generator=torch.Generator().manual_seed(1))
    short = torch.cat([chunk[:, :2], chunk[:, 1:2].expand(-1, T - 2, -1)], dim=1)
    with torch.no_grad():
        expected = (short - bound(short, torch.ones(3)))[:, :2].square().sum(dim=(1, 2))
        assert isinstance(score, Leading)
        torch.testing.assert_close(score(bound, chunk, length=4), expected)
    assert isinstance(wrap(agent, adapter=adapter, gate=True, alpha=0.4, score=BOTH)._corrector.gate.aim(4)[0], Joint)
    edited = wrap(agent, adapter=adapter, gate=True, alpha=0.99, method="fpas")._corrector(
        observation(3), chunk[:, :4], spawn(0, 3, stream="editor")
    )
    assert edited.edited.any() and edited.action.isfinite().all()


def test_a_copilot_is_told_last_proposals_of_the_length_that_is_judged(typed, data, agent, tmp_path):
    adapter = save_policy(tmp_path / "copilot", "gloves_copilot", seed=7)
    run(typed, adapter, data, "--scores=[correction]")
    whole = wrap(agent, adapter=adapter, gate=True, alpha=0.2, score="correction")._corrector
    run(typed, adapter, data, "--scores=[correction]", "--lengths=[2]")
    corrector = wrap(agent, adapter=adapter, gate=True, alpha=0.2, score="correction")._corrector
    drawn = 0.004 * torch.randn(3, 2, 4, 2, generator=torch.Generator().manual_seed(0))
    *before, proposal = drawn
    generators = spawn(0, 2, stream="editor")
    found = corrector(observation(2), proposal, generators, before)
    alone = whole(observation(2), proposal[:, :2], generators, [past[:, :2] for past in before])
    torch.testing.assert_close(found.score, alone.score, rtol=1e-5, atol=1e-6)


def test_long_chunks_are_scored_for_four_lengths(typed, agent, tmp_path, monkeypatch):
    """Of the default scores' 18 evaluations of a chunk, one by one: 72 for each, where every length was 1800."""
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", chunk_size=100)
    root, calls, forward = write_dataset(tmp_path / "data", episodes=1, length=100).root, [], DiT.forward
    monkeypatch.setattr(DiT, "forward", lambda *given: calls.append(1) or forward(*given))
    calibration = run(typed, adapter, root)
    assert calibration.lengths == (1, 25, 50, 100)
    look = 2 * 5  # at the chunk and at another, by the five-step score
    assert len(calls) == 4 * (1 + 2 + 5 + 10) + look
    assert [len(default_lengths(length)) for length in (1, 10, 20, 21, 50, 400)] == [1, 10, 20, 4, 4, 4]
    assert default_lengths(21) == (1, 5, 10, 21)
