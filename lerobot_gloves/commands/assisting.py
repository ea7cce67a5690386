"""What corrects a person: options that several commands share."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class AssistanceConfig:
    """What corrects the person: options of the wrapper, which mean the same as in every other command."""

    # Folder or Hub id of the adapter. By default the copilot that ships with the package, where one does.
    adapter: str | None = None
    # The adapter's Hub revision.
    adapter_revision: str | None = None
    # Options for the adapter's configuration, such as '["--guidance=2"]'.
    adapter_overrides: list[str] = field(default_factory=list)
    # Observation keys of the environment, or the robot, to those that the adapter was trained on.
    adapter_rename_map: dict[str, str] = field(default_factory=dict)
    # The editor and its options, NAME[:KEY=VALUE,...]; by default what gloves tune recommends, else the adapter's own.
    method: str | None = None
    # The nonconformity score of the gate and its options; by default the adapter's own.
    score: str | None = None
    # Whether commands that look like the expert's pass, at first. By default, if the adapter is calibrated.
    gate: bool | None = None
    # The gate's significance level, at first.
    alpha: float | None = None
    # File that receives one JSON line a step of what was done to the commands.
    log: Path | None = None
    # Whether these lines also hold what was commanded and what was executed.
    log_actions: bool = False
    # Where the adapter computes, such as cpu or cuda; by default the best that there is.
    device: str | None = None
