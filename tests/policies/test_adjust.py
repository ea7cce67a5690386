"""A wrapper's method, gate and alpha change while its episode goes on; a person is an agent that holds its command."""

import pytest
import torch

from lerobot_gloves.tasks.configuration import OBS_COMMAND
from lerobot_policy_gloves.gloves_person.configuration_gloves_person import GlovesPersonConfig
from lerobot_policy_gloves.gloves_person.modeling_gloves_person import GlovesPersonPolicy
from tests.builders import calibrate, observation, save_policy, wrap
from tests.policies.test_correction import act

SCORES = {"reverse:steps=1": torch.full((6, 99), 0.25)}
BATCH = observation(2)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checkpoints")
    agent = save_policy(folder / "agent", "gloves_flow_policy", chunk_size=4)
    return agent, calibrate(save_policy(folder / "adapter", "gloves_expert_flow", seed=7), scores=SCORES)


@pytest.mark.parametrize(
    "options", [{"method": "none"}, {"method": "feeg:start=0.2"}, {"gate": True, "alpha": 0.5}, {"method": "fpas"}]
)
def test_adjusted_it_acts_as_if_it_had_been_loaded_so(saved, options):
    agent, adapter = saved
    policy = wrap(agent, adapter=adapter, gate=False)
    policy.adjust(**options)
    assert torch.equal(act(policy, BATCH, 4), act(wrap(agent, adapter=adapter, **options), BATCH, 4))


def test_the_episode_goes_on(saved):
    agent, adapter = saved
    policy, raw = wrap(agent, adapter=adapter), wrap(agent)
    act(policy, BATCH, 4), act(raw, BATCH, 4)
    policy.adjust(method="none")
    assert torch.equal(act(policy, BATCH, 4), act(raw, BATCH, 4))


@pytest.mark.parametrize("options", [{"gate": True, "alpha": 0.001}, {"method": "fly"}, {"score": "nothing"}])
def test_what_cannot_be_changes_nothing(saved, options):
    agent, adapter = saved
    policy = wrap(agent, adapter=adapter)
    with pytest.raises(ValueError):
        policy.adjust(**options)
    assert policy.config.method is None and policy.config.alpha is None
    assert torch.equal(act(policy, BATCH, 4), act(wrap(agent, adapter=adapter), BATCH, 4))


def test_a_person_proposes_the_command_held_and_executes_one_action_of_it():
    policy = GlovesPersonPolicy(GlovesPersonConfig(chunk_size=3, device="cpu"))
    command = torch.tensor([[0.25, -1.0], [0.0, 0.5]])
    chunk = policy.predict_action_chunk({OBS_COMMAND: command})
    assert chunk.shape == (2, 3, 2) and all(torch.equal(chunk[:, step], command) for step in range(3))
    assert torch.equal(policy.select_action({OBS_COMMAND: command}), command) and policy.config.n_action_steps == 1
    with pytest.raises(ValueError, match=r"observation\.command, which is not there: run gloves drive"):
        policy.predict_action_chunk({})
    with pytest.raises(ValueError, match="chunk_size is 0"):
        GlovesPersonConfig(chunk_size=0)
