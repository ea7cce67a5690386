"""Whether an adapter is made for an agent's observations, actions and rate."""

from lerobot.configs import PreTrainedConfig
from lerobot.utils.constants import ACTION

from lerobot_gloves.checkpoints.features import SAME_RATE, check_features, check_rate

from .configuration_gloves import GlovesConfig


def check_fits(agent: GlovesConfig, adapter: PreTrainedConfig) -> None:
    """Refuse an adapter whose actions, observations or rate are not the agent's; it may be given more vectors.

    Actions are compared by size and, where both say what their entries are, by name: of seven numbers, joints and an
    end effector's pose are equally many.

    Raises:
        ValueError: Naming what differs.
    """
    given = {agent.adapter_rename_map.get(key, key): one for key, one in agent.input_features.items()}
    advice = "rename by --policy.adapter_rename_map, or take an adapter for these"
    needed = {key: one for key, one in adapter.input_features.items() if key in given or key in adapter.image_features}
    check_features("the adapter", needed, "the agent", given, advice=advice)
    if agent.output_features:  # else only its actions will tell
        check_features("the adapter", adapter.output_features or {}, "the agent", agent.output_features)
    rate, action = getattr(adapter, "fps", None), agent.output_features.get(ACTION)
    check_rate(rate, "the agent", getattr(agent.agent_config, "fps", None), SAME_RATE)
    check_rate(rate, "the environment", getattr(action, "fps", None), SAME_RATE)  # if it is a task of ours
    ours, theirs = (_action_names(one) for one in (agent.agent_config, adapter))
    if ours and theirs and ours != theirs:
        raise ValueError(
            f"the adapter's actions are {', '.join(theirs)}, but the agent's are {', '.join(ours)}: take an adapter of "
            """these, or, if they mean the same, --policy.adapter_overrides='["--action_feature_names=null"]'"""
        )


def _action_names(config: PreTrainedConfig) -> list[str] | None:
    """What the entries of a policy's actions are, if it knows."""
    names = list(getattr(config, "action_feature_names", None) or [])
    feature = config.action_feature
    return names if feature is not None and len(names) == feature.shape[0] else None
