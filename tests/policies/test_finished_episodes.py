import json
from itertools import pairwise

import torch
from lerobot.envs import preprocess_observation
from lerobot.envs.utils import NEW_ROLLOUT_OPTION
from lerobot.policies import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import rollout

from lerobot_gloves.perturbations import Shift
from lerobot_policy_gloves.gloves.configuration_gloves import PASSTHROUGH
from tests.builders import save_policy, slalom, wrap


def test_an_environment_rests_when_its_episode_is_over():
    with slalom(episode_length=60) as env:
        env.reset(seed=[0, 1], options={NEW_ROLLOUT_OPTION: True})
        after = []
        for _ in range(30):
            observation, reward, terminated, _, _ = env.step([[0.0, 0.01], [0.001, 0.0]])
            if terminated[0]:
                after.append((observation["agent_pos"].copy(), reward.copy(), terminated.copy()))
        assert len(after) > 5  # it hit the first pillar
        first = after[0][0]
        for earlier, later in pairwise(after):
            assert (later[0][0] == first[0]).all() and later[1][0] == 0 and later[2].tolist() == [True, False]
            assert (later[0][1] != earlier[0][1]).any()  # the other goes on
        observation, _ = env.reset(seed=[2, 3], options={NEW_ROLLOUT_OPTION: True})
        assert (observation["agent_pos"][0] == observation["agent_pos"][1]).all()
        assert (observation["agent_pos"][0] != first[0]).any()


def test_only_chunks_of_running_episodes_count_in_lerobots_loop(tmp_path, checkpoints):
    """Straight ahead, pushed aside by chance: two episodes that end at the pillars, one after the other."""
    agent = save_policy(tmp_path / "agent", "act")
    policy = wrap(
        agent,
        adapter=checkpoints.adapter,
        method="none",
        log=tmp_path / "log",
        perturbation=Shift(0, 0.01, 0.5),
        seed=1,
    )
    head, raw = policy._agent.policy.model.action_head, torch.tensor([[0.0, 0.008]])
    mean, std = (policy._agent.postprocess.steps[0]._tensor_stats["action"][key] for key in ("mean", "std"))
    head.weight.data.zero_()
    head.bias.data.copy_(((raw - mean) / std)[0])
    identity, pipelines = PolicyProcessorPipeline(steps=[]), make_pre_post_processors(policy.config, PASSTHROUGH)
    with slalom(batch=3, episode_length=100) as env:
        result = rollout(env, policy, identity, identity, *pipelines, seeds=[0, 1, 2])
    lengths = [int(done.nonzero()[0]) + 1 for done in result["done"]]
    assert len(set(lengths)) > 1 and max(lengths) < 100
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    for episode, length in enumerate(lengths):
        steps = [line["step"] for line in lines if line["episode"] == episode]
        # A chunk that is due at the very step after the end cannot be told from one of a running episode.
        assert steps in (list(range(0, length, 5)), list(range(0, length + 1, 5)))
    assert policy.statistics()["chunks"] == len(lines)


def test_only_proposals_of_running_episodes_are_corrected(tmp_path, checkpoints):
    """Told which episodes run, the wrapper gives them what it gives without being told, and leaves the others alone."""
    agent = save_policy(tmp_path / "agent", "act")
    given = {}
    for method in ("none", "feeg"):
        for running in (None, torch.tensor([True, False, True])):
            policy = wrap(agent, adapter=checkpoints.adapter, method=method, seed=1, log=tmp_path / "log")
            with slalom(batch=3) as env:
                observation, _ = env.reset(seed=[0, 1, 2])
            policy.reset()
            policy.running = running
            given[method, running is None] = policy.select_action(preprocess_observation(observation))
            if running is not None:
                assert policy.correction.edited.tolist() == ([True, False, True] if method == "feeg" else [False] * 3)
                assert policy.correction.evaluations[1] == policy.correction.distance[1] == 0
    for running in (True, False):  # nobody is left: nothing to correct
        policy.reset()
        policy.running = torch.full((3,), running)
        last = policy.select_action(preprocess_observation(observation))
        assert (policy.correction is None) == (not running)
    assert (last == given["none", True]).all()
    raw, told, untold = given["none", True], given["feeg", False], given["feeg", True]
    torch.testing.assert_close(told[[0, 2]], untold[[0, 2]])
    assert (untold != raw).any(dim=1).all()
    assert (told[1] == raw[1]).all()
