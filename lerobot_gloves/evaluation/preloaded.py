"""What processes that play need, imported for all of them at once (see `system.children`): LeRobot and its plugins.

Before anything else one core is theirs, which torch and numpy read once, when they are imported.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"

from lerobot.utils.import_utils import register_third_party_plugins

import lerobot_gloves.evaluation.agent
import lerobot_gloves.evaluation.environments
import lerobot_gloves.evaluation.rollout  # noqa: F401

register_third_party_plugins()
