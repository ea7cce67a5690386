"""Witnesses: which episodes they are, what they say, and what a training makes of it."""

import logging
from types import SimpleNamespace

import pytest
import torch
from lerobot.policies import get_policy_class
from lerobot.scripts.lerobot_train import train

from lerobot_policy_gloves.gloves_copilot.witnesses import Witnesses
from tests.builders import load, make_config, statistics, training_options, write_dataset
from tests.policies.test_training_command import LAST

EPISODES, FRAMES = 200, 400  # the verdict is due after 600 items, of which the last 300 are listened to
B, T, A = 40, 6, 2


def copilot(episodes=EPISODES, frames=FRAMES, **options):
    config = make_config("gloves_copilot", **options)
    stats = statistics(config.output_features)
    meta = SimpleNamespace(stats=stats, total_episodes=episodes, total_frames=frames, fps=20)
    torch.manual_seed(0)
    return get_policy_class("gloves_copilot")(config, dataset_meta=meta).train()


def batch(first=0):
    """One item of each of 40 episodes, two of them witnesses'."""
    generator = torch.Generator().manual_seed(first)
    return {
        "observation.state": torch.randn(B, 4, generator=generator),
        "observation.environment_state": torch.randn(B, 12, generator=generator),
        "action": torch.randn(B, 8 + T, A, generator=generator),
        "episode_index": torch.arange(first, first + B),
    }


def test_one_episode_of_twenty_is_a_witness():
    theirs = Witnesses(200, 400).among(torch.arange(40)[:, None])  # LeRobot may keep a column of one
    assert theirs.nonzero().flatten().tolist() == [19, 39]


@pytest.mark.parametrize(("theirs", "doubted"), [(1.07, False), (1.09, True)])
def test_the_verdict_is_on_what_was_said_in_the_second_half(theirs, doubted, caplog):
    caplog.set_level(logging.INFO)
    witnesses = Witnesses(EPISODES, FRAMES)
    of = torch.tensor([False] * 3 + [True])
    for step in range(60):  # ten items each, of which four drew the mean
        assert witnesses.asked
        early = torch.tensor([1.0, 1.0, 1.0, 9.0])
        late = torch.tensor([1.0, 2.0, 3.0, 2 * theirs])
        witnesses.hear(early if step < 30 else late, of, items=10)
    assert not witnesses.asked and bool(witnesses.doubted) is doubted
    assert witnesses.ratio == pytest.approx(theirs, rel=1e-5)
    assert f"{theirs:.2f} times" in caplog.text and ("by heart" in caplog.text) is doubted


def test_the_items_of_all_processes_count(monkeypatch):
    monkeypatch.setattr("torch.distributed.is_initialized", lambda: True)
    monkeypatch.setattr("torch.distributed.get_world_size", lambda: 4)
    witnesses = Witnesses(EPISODES, FRAMES)
    witnesses.hear(torch.ones(1), torch.tensor([True]), items=100)
    assert witnesses.left == 200


def test_episodes_that_nobody_was_asked_of_are_believed():
    witnesses = Witnesses(EPISODES, FRAMES)
    witnesses.hear(torch.ones(3), torch.tensor([False] * 3), items=600)
    assert not witnesses.asked and not witnesses.doubted


@pytest.mark.parametrize(("episodes", "doubted"), [(99, True), (100, False), (0, False)])
def test_too_few_demonstrations_are_doubted_unasked(episodes, doubted):
    witnesses = Witnesses(episodes, FRAMES if episodes else 0)
    assert bool(witnesses.doubted) is doubted
    assert witnesses.asked is (episodes >= 100)


def test_a_witness_is_not_learned_from_until_the_verdict():
    new, data = copilot(mean_share=1.0, alone_share=0.0), batch()
    for verdict in (False, True):
        new.witnesses.left.fill_(0 if verdict else 600)
        loss, _ = new(data, reduction="none")
        assert (loss == 0).nonzero().flatten().tolist() == ([] if verdict else [19, 39])


def test_the_mean_of_the_loss_is_that_of_those_who_are_learned_from():
    """Of a network that answers nothing, asked for the mean: the action itself, squared."""
    new, data = copilot(mean_share=1.0, alone_share=0.0), batch()
    learned = data["action"][:, -T:].square().mean(dim=(1, 2))
    kept = torch.ones(B, dtype=torch.bool)
    kept[[19, 39]] = False
    assert new(data)[0].item() == pytest.approx(learned[kept].mean().item(), rel=1e-5)
    assert new.eval()(data)[0].item() == pytest.approx(learned.mean().item(), rel=1e-5), "held-out episodes are heard"


def test_what_is_heard_is_how_far_the_mean_is_from_the_experts_chunk():
    new = copilot(mean_share=1.0, alone_share=0.0, samples_per_item=3)
    new.witnesses.left.fill_(300)  # half way
    data = batch()
    data["action_is_pad"] = torch.zeros(B, 8 + T, dtype=torch.bool)
    data["action_is_pad"][:, -2:] = True
    new(data)
    distance = data["action"][:, -T:-2].norm(dim=2).mean(dim=1)  # of a network that answers nothing
    theirs = distance[[19, 39]]
    assert new.witnesses.draws.tolist() == [3 * 38, 3 * 2]
    expected = [3 * (distance.sum() - theirs.sum()).item(), 3 * theirs.sum().item()]
    assert new.witnesses.errors.tolist() == pytest.approx(expected, rel=1e-5)
    assert new.witnesses.left == 300 - B


def test_draws_that_are_told_nothing_or_of_the_flow_are_not_heard():
    new = copilot(mean_share=0.0, alone_share=0.5)
    new.witnesses.left.fill_(300)
    new(batch())
    assert new.witnesses.draws.tolist() == [0, 0]


@pytest.mark.parametrize("doubted", [False, True])
def test_only_a_doubted_context_is_swapped(doubted, monkeypatch):
    new, data = copilot(context_swap=1.0, alone_share=0.0, faults=["scale"]), batch()
    new.witnesses.left.fill_(0)
    new.witnesses.doubted.fill_(doubted)
    seen, bind = {}, new.network.bind

    def spied(observation, tokens):
        seen["tokens"] = tokens
        return bind(observation, tokens=tokens)

    monkeypatch.setattr(new.network, "bind", spied)
    new(data)
    own = new.network.encode(data).repeat_interleave(new.config.samples_per_item, dim=0)
    same = (seen["tokens"] == own).flatten(1).all(dim=1).float().mean()
    assert same == 1 if not doubted else same < 0.2


def learn(known, steps=120, frames=40, items=64):
    """A training that sees a few frames, an episode each, again and again, while an agent repeats itself always.

    Args:
        known: Whether a frame is followed by the same chunk each time, rather than by any.
    """
    options = {"mean_share": 1.0, "alone_share": 0.0, "samples_per_item": 1, "width": 32, "context_dim": 32}
    new = copilot(frames=steps * items * 2 // 3, faults=["replay"], healthy=0.0, **options)
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(frames, 4, generator=generator)
    chunks = torch.randn(frames, 8 + T, A, generator=generator)
    optimiser = torch.optim.Adam(new.network.parameters(), lr=5e-3)
    while new.witnesses.asked:
        rows = torch.randint(frames, (items,), generator=generator)
        data = {
            "observation.state": states[rows],
            "observation.environment_state": torch.zeros(items, 12),
            "action": chunks[rows] if known else torch.randn(items, 8 + T, A, generator=generator),
            "episode_index": rows,
        }
        loss, _ = new(data)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return new.witnesses


def test_what_is_known_by_heart_is_doubted_and_what_cannot_be_is_not():
    by_heart, never = learn(known=True), learn(known=False)
    assert by_heart.doubted and by_heart.ratio > 1.15
    assert not never.doubted and never.ratio < by_heart.ratio - 0.2


def test_a_checkpoint_goes_on_with_what_was_heard(tmp_path, typed):
    write_dataset(tmp_path / "data")
    options = training_options("gloves_copilot", tmp_path / "data", tmp_path / "run", steps=2)
    typed(*options, "--policy.history=2")
    train()
    trained, _ = load(tmp_path / "run" / LAST / "pretrained_model")
    assert trained.witnesses.doubted, "four episodes are few"
    new = copilot()
    new.witnesses.errors.copy_(torch.tensor([3.0, 4.0]))
    new.witnesses.draws.copy_(torch.tensor([3.0, 2.0]))
    new.witnesses.left.fill_(250)
    new.save_pretrained(tmp_path / "half")
    again = get_policy_class("gloves_copilot").from_pretrained(tmp_path / "half")
    assert again.witnesses.asked and again.witnesses.ratio == 2 and again.witnesses.wait == 600
