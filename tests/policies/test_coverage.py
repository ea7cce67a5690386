"""An observation covers the actions from its own moment on: nothing further ahead is corrected, whoever asks."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from lerobot_gloves.adapter import pad
from lerobot_gloves.demo import PACKAGED
from lerobot_gloves.editors import FEEG, Reference
from lerobot_gloves.generators import spawn
from lerobot_gloves.perturbations import Smooth
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import load, observation, save_policy, wrap

EXPERT_FLOW = PACKAGED / "expert_flow"
T, LONG = 6, 9
"""Chunk sizes of the adapter and of an agent."""


@pytest.fixture(scope="module")
def agents(tmp_path_factory):
    """The same agent twice: it executes its chunks whole, or the first T actions of them."""
    folder = tmp_path_factory.mktemp("agents")
    kind = "gloves_flow_policy"
    whole = save_policy(folder / "whole", kind, chunk_size=LONG, n_action_steps=LONG)
    return whole, save_policy(folder / "first", kind, chunk_size=LONG, n_action_steps=T)


def test_what_lies_beyond_the_adapters_chunk_passes_unedited(checkpoints, agents):
    batch = observation(2)
    proposal = wrap(agents[0]).predict_action_chunk(batch)
    policy = wrap(agents[0], adapter=checkpoints.adapter, method="feeg:steps=2")
    chunk = policy.predict_action_chunk(batch)
    assert chunk.shape == proposal.shape == (2, LONG, 2)
    assert torch.equal(chunk[:, T:], proposal[:, T:])
    adapter, (preprocess, postprocess) = load(checkpoints.adapter)
    inputs = {key: value for key, value in batch.items() if key in adapter.config.input_features}
    prepared = preprocess({**inputs, "action": proposal[:, :T]})
    reference = Reference(adapter.velocity(prepared), generator=spawn(0, 2, stream="editor"))
    expected = postprocess(FEEG(steps=2)(prepared["action"], reference))
    torch.testing.assert_close(chunk[:, :T], expected, rtol=1e-4, atol=1e-7)
    assert policy.statistics()["chunks"] == 2, "one for each environment"


@pytest.mark.parametrize("perturbation", [None, Smooth(sigma=0.003)])
def test_asking_for_chunks_and_asking_for_actions_agree(checkpoints, agents, perturbation):
    """Whoever executes T actions of each chunk and then asks again, executes what `select_action` gives."""
    whole, first = agents
    options = {"adapter": checkpoints.adapter, "method": "feeg:steps=2", "perturbation": perturbation}
    one, other = wrap(first, **options), wrap(whole, **options)
    observations = [observation(1, seed=step) for step in range(3 * T)]
    with torch.inference_mode():
        actions = torch.cat([one.select_action(batch) for batch in observations])
    executed, left = [], None
    for batch in observations[::T]:
        chunk = other.predict_action_chunk(batch, prev_chunk_left_over=left)[0]
        executed.append(chunk[:T])
        left = chunk[T:]
    assert torch.equal(torch.cat(executed), actions)
    assert one.statistics()["intervention_rate"] == other.statistics()["intervention_rate"] == 1


SHOWN = {"observation.state": "agent_pos", "observation.environment_state": "environment_state"}


@pytest.fixture(scope="module")
def drives():
    """Episodes of Slalom's scripted expert: what is observed, (n, ...) by LeRobot's keys, and what it does, (n, 2)."""
    config, made = SlalomEnv(obs_type="state"), []
    env = gym.make(config.gym_id, **config.gym_kwargs)
    for seed in (31_000, 31_007, 31_013):
        expert = config.make_expert(np.random.default_rng(seed))
        seen, _ = env.reset(seed=seed)
        expert.reset(env.unwrapped.task_description)
        rows, over = [], False
        while not over:
            action = expert.act(seen)
            rows.append({**{key: seen[name] for key, name in SHOWN.items()}, "action": np.array(action)})
            seen, _, terminated, truncated, _ = env.step(expert.disturb(action))
            over = terminated or truncated
        made.append({key: torch.tensor(np.stack([row[key] for row in rows])) for key in rows[0]})
    env.close()
    return made


def test_an_experts_long_chunks_are_stopped_no_more_often_when_asked_for_as_chunks(tmp_path, drives):
    """Chunks of 50 actions, five times as many as the shipped expert flow's; the bar is 1.5 times as often."""
    agent, ahead = save_policy(tmp_path / "agent", "gloves_flow_policy", chunk_size=50, n_action_steps=50), 50
    _, (preprocess, _) = load(agent)
    begins = [(drive, begin) for drive in drives for begin in range(0, len(drive["action"]) - ahead, 5)]

    def seen(step: int) -> dict[str, torch.Tensor]:
        shown = {key: torch.stack([drive[key][begin + step] for drive, begin in begins]) for key in SHOWN}
        return {**shown, "observation.goal": torch.zeros(len(begins), 9)}

    def planned(step: int) -> torch.Tensor:
        rows = [drive["action"][begin + step : begin + step + ahead] for drive, begin in begins]
        chunks = torch.stack([pad(row[None], ahead)[0] for row in rows])
        return preprocess({**seen(step), "action": chunks})["action"]

    def stopped(ask) -> float:
        policy = wrap(agent, adapter=EXPERT_FLOW, gate=True, alpha=0.2, method="feeg:start=1")
        with torch.inference_mode():
            for step in range(ahead):
                policy._agent.policy.sample = lambda *_, step=step: planned(step)
                ask(policy, step)
        return policy.statistics()["intervention_rate"]

    acting = stopped(lambda policy, step: policy.select_action(seen(step)))
    asking = stopped(lambda policy, step: step % 10 or policy.predict_action_chunk(seen(step)))
    assert 0.05 < acting < 0.5
    assert asking <= 1.5 * acting
