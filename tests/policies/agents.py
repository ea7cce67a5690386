"""LeRobot's agents that read a task, each at its smallest, of random weights and without downloads."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from tests.builders import make_policy, save_policy
from tests.policies import backbones, groot, paligemma, smolvla


def _anything(_: Path) -> AbstractContextManager[None]:
    return nullcontext()


TOLD: dict[str, tuple[Callable[[Path], dict[str, Any]], Callable[[Path], AbstractContextManager[None]]]] = {
    "smolvla": (smolvla.smolvla_options, lambda _: smolvla.without_downloads()),
    "pi0": (paligemma.pi_options, paligemma.small_paligemma),
    "pi05": (paligemma.pi_options, paligemma.small_paligemma),
    "xvla": (backbones.xvla_options, _anything),
    "groot": (groot.groot_options, groot.without_dm_tree),
    "eo1": (backbones.eo1_options, _anything),
    "evo1": (backbones.evo1_options, _anything),
    "vla_jepa": (backbones.vla_jepa_options, _anything),
    "multi_task_dit": (backbones.multi_task_dit_options, _anything),
}
"""What makes the options of a type, its backbone saved in a folder, and what it must be made and loaded under."""


@contextmanager
def saved_agent(folder: Path, kind: str, obs_type: str = "pixels_agent_pos", **options: Any) -> Iterator[Path]:
    """The folder of an agent, as `lerobot-train` leaves it: one of these, or any other that the builders know."""
    if kind not in TOLD:
        yield save_policy(folder / "agent", kind, obs_type, **options)
        return
    describe, surroundings = TOLD[kind]
    chunk = {} if kind == "multi_task_dit" else {"chunk_size": 8}
    with surroundings(folder / "backbone"):
        made = {**describe(folder / "backbone"), **chunk, "n_action_steps": 5, **options}
        yield save_policy(folder / "agent", kind, policy=make_policy(kind, obs_type, **made))
