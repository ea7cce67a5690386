"""From plans to raw actions: what "bit for bit" means where a postprocessor looks at the moment, or at the place."""

from dataclasses import dataclass

import pytest
import torch
from lerobot.processor import (
    AbsoluteActionsProcessorStep,
    PolicyActionProcessorStep,
    RelativeActionsProcessorStep,
)

from tests.builders import load, observation, save_policy, wrap

N = 5
"""Actions of the agent's chunks that are executed, of 8."""
OBSERVATIONS = [observation(2, seed=step) for step in range(2 * N)]


@pytest.fixture(scope="module")
def agent(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("agent") / "act", "act")


@dataclass
class ByPlace(PolicyActionProcessorStep):
    """Decodes by an action's place in its chunk, as GR00T does; an action by itself as a chunk's first."""

    alone: bool = True

    def action(self, action: torch.Tensor) -> torch.Tensor:
        if action.ndim == 2 and not self.alone:
            raise NotImplementedError("decode the full chunk")
        places = torch.arange(action.shape[1]) if action.ndim == 3 else torch.zeros(())
        return action + places[..., None]

    def transform_features(self, features):
        return features


class Binary(ByPlace):
    """A gripper that is open or closed, as LeRobot's VLA-JEPA has it: decoded again, it would be the other."""

    def action(self, action: torch.Tensor) -> torch.Tensor:
        gripper = 1.0 - 2.0 * (action[..., -1:] > -0.001).float()
        return torch.cat([action[..., :-1], gripper], dim=-1)


class Flat(ByPlace):
    """Takes nothing but (B, A): of a chunk it would take the last action for the gripper."""

    def action(self, action: torch.Tensor) -> torch.Tensor:
        action = action.clone()
        action[:, -1] = action[:, -1].sign()
        return action


def play(policy, batches=OBSERVATIONS) -> torch.Tensor:
    with torch.inference_mode():
        return torch.stack([policy.select_action(dict(batch)) for batch in batches], dim=1)


def relative(preprocess, postprocess) -> None:
    """Actions are relative to the first entries of the state at hand, as pi0's and pi0.5's may be."""
    step = RelativeActionsProcessorStep(enabled=True)
    preprocess.steps = [step, *preprocess.steps]
    postprocess.steps = [*postprocess.steps, AbsoluteActionsProcessorStep(enabled=True, relative_step=step)]


def test_relative_actions_start_from_where_they_were_planned(agent, checkpoints):
    """Bit for bit what the bare agent's own processors make of each plan when it is made, as LeRobot's servers do."""
    bare, (preprocess, postprocess) = load(agent)
    relative(preprocess, postprocess)
    with torch.inference_mode():
        planned = []
        for batch in OBSERVATIONS[::N]:
            chunk = bare.predict_action_chunk(preprocess(dict(batch)))[:, :N]
            planned.append(postprocess(chunk))
        bare.reset()
        alone = []
        for batch in OBSERVATIONS:
            alone.append(postprocess(bare.select_action(preprocess(dict(batch)))))
    expected, popped = torch.cat(planned, dim=1), torch.stack(alone, dim=1)
    for options in ({}, {"adapter": checkpoints.adapter, "method": "none"}):
        policy = wrap(agent, **options)
        relative(policy._agent.preprocess, policy._agent.postprocess)
        assert torch.equal(play(policy), expected)
    # LeRobot's loop adds the state of the moment at which an action is due: the same for a plan's first one alone.
    assert torch.equal(expected[:, ::N], popped[:, ::N])
    behind = torch.arange(2 * N) % N > 0
    moved = torch.stack([batch["observation.state"][:, :2] for batch in OBSERVATIONS], dim=1)
    drift = moved - moved[:, ::N].repeat_interleave(N, dim=1)
    torch.testing.assert_close((popped - expected)[:, behind], drift[:, behind], rtol=1e-4, atol=1e-6)
    assert drift[:, behind].abs().max() > 1


@pytest.mark.parametrize("alone", [True, False])
def test_an_action_is_decoded_by_its_place_in_its_chunk(agent, alone):
    plain, policy = wrap(agent), wrap(agent)
    policy._agent.postprocess.steps.append(ByPlace(alone=alone))
    places = (torch.arange(2 * N) % N).float()[None, :, None]
    assert torch.equal(play(policy), play(plain) + places)


def test_a_postprocessor_that_takes_actions_only_gets_actions_only(agent):
    plain, policy = play(wrap(agent)), wrap(agent)
    policy._agent.postprocess.steps.append(Flat())
    assert torch.equal(play(policy), torch.stack([plain[..., 0], plain[..., 1].sign()], dim=-1))


def test_a_binary_gripper_is_binary_after_an_edit(agent, checkpoints):
    plain, policy = wrap(agent, adapter=checkpoints.adapter), wrap(agent, adapter=checkpoints.adapter)
    policy._agent.postprocess.steps.append(Binary())
    executed = play(policy)
    assert set(executed[..., 1].unique().tolist()) == {-1.0, 1.0}
    assert policy.statistics()["intervention_rate"] == 1
    values = executed[..., 0].unique()
    assert len(values) == executed[..., 0].numel(), "the other entry may have any value"
    assert not policy._decode._discrete.keys() - {1} and not plain._decode._discrete
