"""An adapter's chunks are stretches of time: it corrects nothing that runs at another rate."""

from importlib.resources import files

import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import PushtEnv
from lerobot.policies import make_policy, make_policy_config

import lerobot_gloves.demo
from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import save_policy, wrap

LINE = "the adapter was trained on 50 frames a second, but {} has {}: take one of the same rate, or, if that figure is "


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rates")
    for fps in (10, 20, 50, None):
        save_policy(folder / f"adapter_{fps}", "gloves_expert_flow", fps=fps)
    save_policy(folder / "agent_20", "gloves_flow_policy", fps=20)
    save_policy(folder / "act", "act")
    return folder


def test_an_agent_of_another_rate_is_refused_where_both_are_known(folder):
    with pytest.raises(ValueError, match="^" + LINE.format("the agent", 20)):
        wrap(folder / "agent_20", adapter=folder / "adapter_50")
    wrap(folder / "agent_20", adapter=folder / "adapter_50", adapter_overrides=["--fps=null"])
    for agent, adapter in (("agent_20", "adapter_20"), ("agent_20", "adapter_None"), ("act", "adapter_50")):
        wrap(folder / agent, adapter=folder / adapter)


def test_a_task_of_ours_says_its_rate_to_every_command(folder):
    """As `lerobot-eval` makes a wrapper: it is told no more than the environment's features."""
    config = make_policy_config("gloves", agent=str(folder / "act"), adapter=str(folder / "adapter_50"))
    with pytest.raises(ValueError, match="^" + LINE.format("the environment", 20)):
        make_policy(config, env_cfg=SlalomEnv())


def test_a_stock_environment_does_to_our_commands(folder):
    with pytest.raises(ValueError, match="^" + LINE.format("pusht", 10)):
        load_agent(PushtEnv(), str(folder / "act"), "none", 0, adapter=str(folder / "adapter_50"))


def test_checkpoints_of_before_are_of_an_unknown_rate():
    assert PreTrainedConfig.from_pretrained(str(files(lerobot_gloves.demo) / "expert_flow")).fps is None
