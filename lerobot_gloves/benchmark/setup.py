"""What a cell is played with, and what of it decides the cell's episodes."""

import os
from dataclasses import dataclass, field
from typing import Any

from lerobot.envs import EnvConfig
from lerobot.policies import get_policy_class

from lerobot_gloves.benchmark.adapter_options import check_options, told_options
from lerobot_gloves.benchmark.cell import Cell, gated
from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.evaluation.agent import WrappedAgent, load_agent
from lerobot_gloves.evaluation.seeds import BAND, SPLITS, policy_seed
from lerobot_gloves.specification import NONE, parse_all, parse_optional, specification


@dataclass(kw_only=True, eq=False)
class Setup:
    """What a cell is played with, besides its perturbation, editor and seed.

    Attributes:
        env: The task.
        agent: The policy to be corrected: a checkpoint's folder or Hub id.
        adapter: The checkpoint that scores and edits: a folder or Hub id. The raw agent does without.
        split: Environment seeds to use: test, or validation for choosing settings.
        episodes: Episodes of the cell, at most 100.
        batch_size: Environments that run side by side.
        score: Nonconformity score and its options; None for the adapter's first, if it has any.
        alpha: The gate's significance level.
        options: Further options of the wrapper for its adapter, such as `adapter_overrides` (see `adapter_options`).
        fast_rendering: Whether MuJoCo draws without multisampling and with coarser shadows.

    Raises:
        ValueError: If split, episodes or batch size is not valid.
    """

    env: EnvConfig
    agent: str
    adapter: str | None = None
    split: str = "test"
    episodes: int = 30
    batch_size: int = 30
    score: str | None = None
    alpha: float = 0.05
    options: dict[str, Any] = field(default_factory=dict)
    fast_rendering: bool = False

    def __post_init__(self) -> None:
        self.agent = os.path.expanduser(self.agent)
        self.adapter = self.adapter and os.path.expanduser(self.adapter)
        if self.split not in SPLITS:
            raise ValueError(f"unknown split {self.split!r}: choose from {', '.join(SPLITS)}")
        if not 1 <= self.episodes <= BAND:
            raise ValueError(f"episodes is {self.episodes}, but must lie between 1 and {BAND}")
        if self.batch_size < 1:
            raise ValueError(f"batch_size is {self.batch_size}, but must be at least 1")
        self.batch_size = min(self.batch_size, self.episodes)


def resolve_method(setup: Setup, editor: str, gate: bool) -> dict[str, Any]:
    """Editor, gate, score, alpha and options with every option written out; loads no weights.

    Raises:
        ValueError: If one of them is not valid; the message lists what is.
    """
    if editor == NONE:
        return {"editor": NONE, "gate": False}
    if setup.adapter is None:
        raise ValueError(f"method {gated(editor, gate)!r} needs an adapter, a trained checkpoint")
    adapter: Any = get_policy_class(checkpoint_config("adapter", setup.adapter).type)
    if not hasattr(adapter, "editors"):
        raise ValueError(f"{setup.adapter} is a policy of type {adapter.name!r}, which cannot correct another one")
    chosen = specification(parse_optional(editor, adapter.editors, "method"), adapter.editors)
    resolved: dict[str, Any] = {"editor": chosen, "gate": gate, "score": None, "alpha": None}
    if adapter.scores:
        score = setup.score or next(iter(adapter.scores))
        asked = parse_all(score, adapter.scores, "score")
        resolved["score"] = "+".join(specification(one, adapter.scores) for one in asked)
        resolved["alpha"] = setup.alpha
    elif gate or setup.score is not None:
        raise ValueError(
            f"method {gated(editor, gate)!r} with score {setup.score!r}: a policy of type {adapter.name!r} has no "
            "scores, and so no gate: leave out both"
        )
    check_options(setup.options)
    return {**resolved, "options": setup.options} if setup.options else resolved


def agent_flow(setup: Setup, cell: Cell) -> str | None:
    """The second checkpoint that a cell's adapter takes v_u from, a folder or Hub id; None if there is none.

    Raises:
        ValueError: If the adapter has no such options as the cell's method gives it.
    """
    if setup.adapter is None or cell.raw:
        return None
    overrides = told_options(setup.options, cell.perturbation).get("adapter_overrides", ())
    return getattr(checkpoint_config("adapter", setup.adapter, overrides), "agent_flow", None)


def load(setup: Setup, cell: Cell) -> WrappedAgent:
    """The wrapped agent of a cell."""
    corrected: dict[str, Any] = {"method": cell.editor}
    if not cell.raw:
        corrected |= {
            "adapter": setup.adapter,
            "gate": cell.gate,
            "alpha": setup.alpha,
            "score": setup.score,
            **told_options(setup.options, cell.perturbation),
        }
    seed = policy_seed(setup.split, cell.seed)
    return load_agent(setup.env, setup.agent, cell.perturbation, seed, **corrected)
