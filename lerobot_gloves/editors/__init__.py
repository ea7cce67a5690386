"""Editors: the rules that move a proposal towards the expert's actions. One rule, one file."""

from lerobot_gloves.editors.feeg import FEEG
from lerobot_gloves.editors.fpas import FPAS
from lerobot_gloves.editors.ifae import IFAE

__all__ = ["FEEG", "FPAS", "IFAE"]
