"""The adapter sees all that an agent proposes, also what is not executed: that is as much as without an adapter."""

import pytest
import torch

from lerobot_gloves.perturbations import Delayed, Laggy
from tests.builders import observation, save_policy, wrap
from tests.policies.agents import saved_agent
from tests.policies.test_correction import Spy

T = 6
"""Chunk size of the adapter."""
OBSERVATIONS = [observation(2, seed=step) for step in range(12)]


def play(policy, batches=OBSERVATIONS) -> torch.Tensor:
    with torch.inference_mode():
        return torch.stack([policy.select_action(batch) for batch in batches], dim=1)


def judged(calls) -> list[tuple[int, int]]:
    """At which step how many actions were judged."""
    return [(step, proposal.shape[1]) for step, _, proposal, _ in calls]


def heard(policy, name: str, part=lambda agent: agent) -> list[torch.Tensor]:
    """What a method of the agent returns from now on."""
    owner, results = part(policy._agent.policy), []
    method = getattr(owner, name)

    def listened(*args, **kwargs):
        results.append(method(*args, **kwargs))
        return results[-1]

    owner.__dict__[name] = listened
    return results


def raw(policy, chunk: torch.Tensor) -> torch.Tensor:
    """Action by action, as LeRobot's commands do."""
    return torch.stack([policy._agent.postprocess(action) for action in chunk.clone().unbind(dim=1)], dim=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("agents")


def test_a_part_of_a_chunk_is_executed_and_all_of_it_judged(folder, checkpoints):
    """8 actions, of which 5 are executed; the adapter's chunks have 6."""
    policy = wrap(save_policy(folder / "act", "act"), adapter=checkpoints.adapter, method="feeg:steps=2")
    spy, chunks = Spy(policy), []
    policy._agent.policy.model.register_forward_hook(lambda *given: chunks.append(given[2][0]))
    executed = play(policy)
    assert judged(spy.calls) == [(0, 6), (5, 6), (10, 6)]
    for (step, _, proposal, correction), chunk in zip(spy.calls, chunks, strict=True):
        assert torch.equal(proposal, raw(policy, chunk[:, :T]))
        last = min(step + 5, 12)
        assert torch.equal(executed[:, step:last], correction.action[:, : last - step])


def test_what_is_left_to_execute_is_judged_with_what_lies_behind_it(folder, checkpoints):
    """Of 20 actions 10 are executed: those of the second window are 4, and it shows 6."""
    long = save_policy(folder / "long", "act", chunk_size=20, n_action_steps=10)
    policy = wrap(long, adapter=checkpoints.adapter, method="none")
    spy = Spy(policy)
    assert torch.equal(play(policy), play(wrap(long)))
    assert judged(spy.calls) == [(0, 6), (6, 6), (10, 6)]


def test_diffusion_draws_more_than_it_returns(folder, checkpoints):
    """A horizon of 8 with one observation that lies behind: 7 actions from now on, 4 of which are executed."""
    policy = wrap(save_policy(folder / "diffusion", "diffusion"), adapter=checkpoints.adapter, method="none")
    spy, drawn = Spy(policy), heard(policy, "conditional_sample", lambda agent: agent.diffusion)
    torch.manual_seed(0)
    executed = play(policy)
    assert judged(spy.calls) == [(0, 6), (4, 6), (8, 6)]
    for (_, _, proposal, _), sample in zip(spy.calls, drawn, strict=True):
        assert torch.equal(proposal, raw(policy, sample[:, 1 : 1 + T]))
    bare = wrap(folder / "diffusion")
    torch.manual_seed(0)
    assert torch.equal(executed, play(bare))


def test_temporal_ensembling_proposes_what_it_has_blended(folder, checkpoints):
    """ACT's chunks of 8 at every step: the mean, weighted as ACT weighs it, of those that speak of the same moment."""
    ensembled = save_policy(folder / "ensembled", "act_ensembled")
    policy = wrap(ensembled, adapter=checkpoints.adapter, method="none")
    spy, chunks = Spy(policy), []
    policy._agent.policy.model.register_forward_hook(lambda *given: chunks.append(given[2][0].clone()))
    executed = play(policy)
    assert judged(spy.calls) == [(step, T) for step in range(12)]
    assert torch.equal(executed, play(wrap(ensembled)))
    for step in (0, 3, 11):
        for ahead in range(T):
            made = [at for at in range(step + 1) if step + ahead - at < 8]  # the oldest first
            weights = torch.exp(-0.01 * torch.arange(len(made)))
            speak = torch.stack([chunks[at][:, step + ahead - at] for at in made])
            blended = (weights[:, None, None] * speak).sum(dim=0) / weights.sum()
            expected = raw(policy, blended[:, None])[:, 0]
            torch.testing.assert_close(spy.calls[step][2][:, ahead], expected, rtol=1e-4, atol=1e-7)


def test_tdmpc_proposes_its_plan(folder, checkpoints):
    """By default its first action is repeated, in the place of the plan's next one."""
    options = {"n_action_steps": 1, "n_action_repeats": 2, "horizon": 5}
    agent = save_policy(folder / "tdmpc", "tdmpc", **options)
    policy = wrap(agent, adapter=checkpoints.adapter, method="none")
    spy, plans = Spy(policy), heard(policy, "plan")
    torch.manual_seed(1)
    executed = play(policy)
    assert judged(spy.calls) == [(step, 5) for step in range(0, 12, 2)]
    for (_, _, proposal, _), plan in zip(spy.calls, plans, strict=True):
        plan = plan.clamp(-1, 1)
        assert torch.equal(proposal, raw(policy, plan[[0, 0, 2, 3, 4]].transpose(0, 1)))
    bare = wrap(agent)
    torch.manual_seed(1)
    assert torch.equal(executed, play(bare))


def test_groot_executes_as_few_as_its_checkpoint_says(tmp_path):
    """Eight of the twelve that it is asked for, and draws."""
    options = {"chunk_size": 12, "n_action_steps": 12, "embodiment_tag": "libero_sim"}
    with saved_agent(tmp_path, "groot", **options) as agent:
        policy = wrap(agent)
        seen = [{**observation(2, "pixels_agent_pos", seed=step), "task": ["move", "go"]} for step in range(9)]
        chunks = heard(policy, "predict_action_chunk")
        play(policy, seen[:8])
        assert [chunk.shape[1] for chunk in chunks] == [12] and policy.executed == 8
        play(policy, seen[8:])
        assert len(chunks) == 2


def test_a_delay_counts_the_actions_that_ran(folder, checkpoints):
    """5 actions of each chunk of 8 are executed: what comes 3 steps late is what the agent meant 3 steps ago."""
    agent = save_policy(folder / "delayed", "act")
    meant, late = play(wrap(agent)), play(wrap(agent, perturbation=Delayed(steps=3)))
    expected = torch.cat([meant[:, :1].expand(-1, 3, -1), meant[:, :-3]], dim=1)
    assert torch.equal(late, expected)


def test_the_chunk_after_a_short_first_one_may_be_repeated(folder):
    """As LingBot-VA's, whose first chunk lacks the actions of a frame that is there already."""
    policy = wrap(save_policy(folder / "short", "gloves_flow_policy", n_action_steps=6), perturbation=Laggy(p=1.0))
    lengths = iter([4, 6, 6])
    policy._agent.policy.sample = lambda network, noise: noise[:, : next(lengths)]
    executed = play(policy)
    first = executed[:, :4]
    expected = torch.cat([first, first, first[:, -1:].expand(-1, 2, -1), first[:, :2]], dim=1)
    assert torch.equal(executed, expected)
