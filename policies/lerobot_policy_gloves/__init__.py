"""GLOVES for LeRobot. Importing this registers its policies, its environments and `--policy.wrap`.

LeRobot's commands import it by themselves, because the distribution's name begins with `lerobot_policy_`.
"""

import lerobot_gloves.tasks  # noqa: F401
import lerobot_policy_csa_assist  # noqa: F401
import lerobot_policy_ddpm_assist  # noqa: F401

from . import typed
from .gloves import environments
from .gloves.configuration_gloves import GlovesConfig
from .gloves.seam import install
from .gloves_align_flow.configuration_gloves_align_flow import GlovesAlignFlowConfig
from .gloves_copilot.configuration_gloves_copilot import GlovesCopilotConfig
from .gloves_expert_flow.configuration_gloves_expert_flow import GlovesExpertFlowConfig
from .gloves_flow_policy.configuration_gloves_flow_policy import GlovesFlowConfig
from .gloves_person import processor_teleoperation  # noqa: F401
from .gloves_person.configuration_gloves_person import GlovesPersonConfig

install()
environments.install()
typed.install()

__all__ = [
    "GlovesAlignFlowConfig",
    "GlovesConfig",
    "GlovesCopilotConfig",
    "GlovesExpertFlowConfig",
    "GlovesFlowConfig",
    "GlovesPersonConfig",
]
