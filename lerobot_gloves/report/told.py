"""What a corrector knows of the fault that it mends, by the conditions of its rows."""

import json

from lerobot_gloves.benchmark.cell import PERTURBED
from lerobot_gloves.benchmark.row import Row
from lerobot_gloves.specification import NONE, name_of

WHAT_IT_IS_TOLD = "what it is told"
"""How the line of a table begins that says so."""
NOTHING = "nothing"
KINDS_OF_FAULTS = "kinds of faults"
NAME_AND_DATA = "the fault's name\nand its data"
BLIND = (NONE, "ddpm", "csa", "fpas", "feeg")
"""Editors whose training saw the expert alone; `none` is the raw agent."""
DRAWN = "copilot"
"""The editor whose training drew faults of six kinds."""


def told(row: Row) -> str | None:
    """What the corrector of a row is told of the fault.

    Returns:
        `NOTHING`, `KINDS_OF_FAULTS` or `NAME_AND_DATA`; None where the row does not say, as of other people's editors.
    """
    own, editor = row.conditions, name_of(row.conditions["editor"])
    options = json.dumps(own.get("options") or {})
    if PERTURBED in options or "--agent_source" in options or own.get("agent_flow"):
        return NAME_AND_DATA
    if editor == DRAWN:
        return KINDS_OF_FAULTS
    return NOTHING if editor in BLIND else None
