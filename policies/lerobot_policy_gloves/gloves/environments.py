"""What an environment's observations and actions go through for an agent of one type alone: X-VLA's."""

import sys
from functools import wraps
from typing import Any

from lerobot.envs import EnvConfig, factory

from .configuration_gloves import GlovesConfig

NAME = "make_env_pre_post_processors"


def install() -> None:
    """Teach LeRobot's commands to ask for them by a wrapper's agent; the second time changes nothing.

    They choose by the class of a policy's configuration, and a command has its own reference to the function that does
    before it imports plugins.
    """
    original = getattr(factory, NAME)
    if hasattr(original, "__wrapped__"):
        return

    @wraps(original)
    def by_agent(env_cfg: EnvConfig, policy_cfg: Any) -> Any:
        return original(env_cfg, policy_cfg.agent_config if isinstance(policy_cfg, GlovesConfig) else policy_cfg)

    for name, module in list(sys.modules.items()):
        if (name == "__main__" or name.startswith("lerobot.")) and vars(module).get(NAME) is original:
            setattr(module, NAME, by_agent)
