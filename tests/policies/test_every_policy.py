"""Every chunk policy of LeRobot's that can be built here: not edited it is itself, bit for bit; edited it is not.

In LeRobot's own evaluation, of episodes of several lengths and two tasks, more of them than environments. The bare
agent, which every wrapped one is compared with, plays in this process; one of the wrapped plays in processes.
"""

import math
from collections.abc import Iterator, Sequence

import gymnasium as gym
import pytest
import torch
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.processor import PolicyProcessorPipeline
from torch import Tensor

from tests.builders import FLOW, Pipelines, calibrate, load, observation, save_policy
from tests.policies.agents import TOLD, saved_agent
from tests.policies.toyworld import TASKS, world

BATCH, EPISODES, FIRST_SEED = 2, 3, 100
LONGEST_OF_BATCH = (14, 12)
"""Steps of the longest episode of each batch: four seeds from the first one."""
AGENTS = [
    ("gloves_flow_policy", "state"),
    ("gloves_flow_policy", "pixels_agent_pos"),
    ("act", "state"),
    ("act", "pixels_agent_pos"),
    ("act_ensembled", "state"),
    ("diffusion", "state"),
    ("diffusion", "pixels_agent_pos"),
    ("vqbet", "pixels_agent_pos"),
    ("tdmpc", "state"),  # its chunks are (n, B, A), and here n is B
    *((kind, "pixels_agent_pos") for kind in TOLD),
]
COVERED = FLOW["chunk_size"]
SINGLE = {(kind, "pixels_agent_pos") for kind in ("diffusion", "vqbet", "multi_task_dit")}
"""Asked for a chunk itself, the bare agent misses images that only its `select_action` puts together."""


@pytest.fixture(scope="module")
def here() -> Iterator[gym.vector.VectorEnv]:
    with world(BATCH) as env:
        yield env


@pytest.fixture(scope="module")
def elsewhere() -> Iterator[gym.vector.VectorEnv]:
    with world(BATCH, in_processes=True) as env:
        yield env


@pytest.fixture(scope="module")
def adapters(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adapters")
    return {
        obs_type: calibrate(save_policy(folder / obs_type, "gloves_expert_flow", obs_type, seed=7))
        for obs_type in ("state", "pixels_agent_pos")
    }


def evaluate(env: gym.vector.VectorEnv, policy, pipelines: Pipelines) -> dict[str, Tensor]:
    """What LeRobot's evaluation has seen and done, a row a step."""
    from lerobot.scripts.lerobot_eval import eval_policy  # takes seconds to import

    nothing = PolicyProcessorPipeline(steps=[])
    options = {"n_episodes": EPISODES, "start_seed": FIRST_SEED, "return_episode_data": True}
    return eval_policy(env, policy, nothing, nothing, *pipelines, **options)["episodes"]


def ask(policy, pipelines: Pipelines, kind: str, obs_type: str, tasks: Sequence[str] = TASKS) -> Tensor:
    """The chunk (B, n, A) that a policy gives who asks it for one, as asynchronous inference does."""
    prepare, finish = pipelines
    seen = {**observation(BATCH, obs_type), "task": list(tasks)}
    policy.reset()
    torch.manual_seed(1)
    with torch.inference_mode():
        action = finish(policy.select_action(prepare(dict(seen))))  # so that who looks back has seen something
        if (kind, obs_type) in SINGLE:
            return action[:, None]
        return finish(policy.predict_action_chunk(prepare(dict(seen))))


@pytest.mark.parametrize(("kind", "obs_type"), AGENTS)
def test_not_edited_it_is_the_bare_agent_and_edited_it_is_not(tmp_path, here, elsewhere, adapters, kind, obs_type):
    correct = ["--wrap=gloves", f"--adapter={adapters[obs_type]}"]
    with saved_agent(tmp_path, kind, obs_type) as agent:

        def played(env: gym.vector.VectorEnv, *options: str):
            # As in `lerobot-eval`: seeded once, before the policy is made, which draws random numbers too.
            torch.manual_seed(0)
            policy, pipelines = load(agent, *options)
            episodes = evaluate(env, policy, pipelines)
            chunks = 0 if not options else policy.statistics()["chunks"]
            return policy, episodes, chunks, ask(policy, pipelines, kind, obs_type)

        policy, bare, _, chunk = played(here)
        if kind == "tdmpc":  # (n, B, A)
            chunk = chunk.transpose(0, 1)
        executed = getattr(policy.config, "n_action_steps", None) or policy.config.action_chunk_size  # VQ-BeT's
        planned = BATCH * sum(math.ceil(steps / executed) for steps in LONGEST_OF_BATCH)
        assert [len(bare["action"][bare["episode_index"] == row]) for row in range(4)] == [15, 14, 13, 12]
        for name, env, options in [
            ("no adapter", here, ["--wrap=gloves"]),
            ("all admitted", here, [*correct, "--gate=true", "--alpha=0"]),
            ("no editor", elsewhere, [*correct, "--method=none"]),
        ]:
            _, same, chunks, asked = played(env, *options)
            assert all(torch.equal(same[key], bare[key]) for key in bare), name
            assert torch.equal(asked, chunk), name
            assert chunks == (0 if name == "no adapter" else planned), name
        policy, edited, chunks, asked = played(here, *correct)
        assert chunks == planned and policy.statistics()["intervention_rate"] == 1
        assert (edited["action"] != bare["action"]).all()
        at = edited["observation.state"][:, :2] != bare["observation.state"][:, :2]
        assert at[edited["frame_index"] == 1].all() and not at[edited["frame_index"] == 0].any()
        assert (asked[:, :COVERED] != chunk[:, :COVERED]).all() and torch.equal(asked[:, COVERED:], chunk[:, COVERED:])
        if kind in TOLD:
            torch.manual_seed(0)
            policy, pipelines = load(agent, "--wrap=gloves")
            assert (ask(policy, pipelines, kind, obs_type, TASKS[::-1]) != chunk).any(), "it is told the task"


@pytest.mark.parametrize("kind", ["smolvla", "pi0", "pi05", "evo1", "groot"])
def test_in_real_time_it_goes_on_from_what_is_left_as_the_bare_agent(tmp_path, kind):
    """The bare agent is given what is left as it was drawn, normalised, the wrapped one as it returned it, raw."""
    first, then = ({**observation(1, "pixels_agent_pos", seed=seed), "task": [TASKS[0]]} for seed in range(2))

    def chunks(agent, ran: int | None, *options: str) -> list[Tensor]:
        policy, (prepare, finish) = load(agent, *options)
        policy.config.rtc_config = RTCConfig(execution_horizon=4)
        if hasattr(policy, "init_rtc_processor"):  # as `lerobot-rollout`: GR00T has none
            policy.init_rtc_processor()
        torch.manual_seed(1)
        returned = policy.predict_action_chunk(prepare(dict(first)))
        told = {} if ran is None else {"inference_delay": 1, "prev_chunk_left_over": returned[0, ran:]}
        continued = policy.predict_action_chunk(prepare(dict(then)), **told)
        return [finish(returned.detach()), finish(continued.detach())]

    with saved_agent(tmp_path, kind) as agent:
        expected, wrapped = chunks(agent, 2), chunks(agent, 2, "--wrap=gloves")
        assert torch.equal(wrapped[0], expected[0])
        torch.testing.assert_close(wrapped[1], expected[1], rtol=1e-4, atol=1e-6)
        assert not torch.isclose(chunks(agent, None)[1], expected[1], rtol=1e-2).all(), "what is left matters"
