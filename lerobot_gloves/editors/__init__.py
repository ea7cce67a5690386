"""Editors: the rules that move a proposal towards the expert's actions. One rule, one file, all called alike.

An editor is a frozen dataclass of numbers, called as `editor(proposal, reference) -> chunk`.
"""

from lerobot_gloves.editors.copilot import Copilot
from lerobot_gloves.editors.feeg import FEEG
from lerobot_gloves.editors.fpas import FPAS
from lerobot_gloves.editors.ifae import IFAE
from lerobot_gloves.editors.reference import Reference

EDITORS: dict[str, type] = {"feeg": FEEG, "fpas": FPAS, "ifae": IFAE}
"""Editors by name. One that another package enters here is a method of every adapter that is a flow. `Copilot` is the
editor of those that read proposals alone."""

__all__ = ["EDITORS", "FEEG", "FPAS", "IFAE", "Copilot", "Reference"]
