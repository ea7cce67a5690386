"""What LeRobot puts between an environment and agents of one type stands there for a wrapped one too."""

import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.envs import factory
from lerobot.scripts import lerobot_eval

from lerobot_gloves.evaluation.agent import load_agent
from lerobot_policy_gloves.gloves import environments
from tests.policies.agents import saved_agent
from tests.policies.toyworld import WorldEnv

MAKER = environments.NAME


@pytest.mark.parametrize("kind", ["xvla", "act"])
def test_lerobots_evaluation_asks_for_them_by_the_agent(tmp_path, monkeypatch, kind):
    """Its X-VLA acts in another form of action than LIBERO takes, and sees another state than it shows."""
    lerobots = getattr(factory, MAKER).__wrapped__
    with monkeypatch.context() as before_plugins:
        for module in (factory, lerobot_eval):
            before_plugins.setattr(module, MAKER, lerobots)
        environments.install()
        with saved_agent(tmp_path, kind) as agent:
            bare = PreTrainedConfig.from_pretrained(agent)
            wrapped = PreTrainedConfig.from_pretrained(agent, cli_overrides=["--wrap=gloves"])
        expected = lerobots(env_cfg=WorldEnv(), policy_cfg=bare)
        given = getattr(lerobot_eval, MAKER)(env_cfg=WorldEnv(), policy_cfg=wrapped)
    assert [[type(step) for step in one.steps] for one in given] == [
        [type(step) for step in one.steps] for one in expected
    ]
    assert any(one.steps for one in given) == (kind == "xvla")


def test_so_do_our_commands(tmp_path):
    with saved_agent(tmp_path, "xvla") as agent:
        assert not load_agent(WorldEnv(), str(agent), "none", 0).direct
