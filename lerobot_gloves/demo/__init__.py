"""The demo: a small trained Slalom trio, and what `gloves demo` shows with it."""

from pathlib import Path

AGENT, EXPERT_FLOW, COPILOT = TRIO = ("agent", "expert_flow", "copilot")
"""Names of the trio's folders, and of the training configurations (`.yaml`) that made them."""
PACKAGED = Path(__file__).parent
"""Where the trio that ships with the package lies."""
PERSONS_COPILOT = "copilot_person"
"""Name of the folder of the copilot for a person at the controls, beside the trio: configs/cpu/copilot_person.yaml."""
