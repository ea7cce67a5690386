"""The demo: a small trained Slalom pair, and what `gloves demo` shows with it."""

from pathlib import Path

AGENT, EXPERT_FLOW = PAIR = ("agent", "expert_flow")
"""Names of the pair's folders, and of the training configurations (`.yaml`) that made them."""
PACKAGED = Path(__file__).parent
"""Where the pair that ships with the package lies."""
