"""What a wrapper does with its adapter, once user, recommendation and defaults have been heard."""

from dataclasses import dataclass

from lerobot_gloves.adapter import Adapter
from lerobot_gloves.checkpoints.recommendation import Recommendation

from .configuration_gloves import GlovesConfig

ALPHA = 0.05


@dataclass(frozen=True)
class Settings:
    """Method and gate.

    Attributes:
        method: Specification of the editor, `none` for none.
        gate: Whether chunks that look like the expert's pass.
        score: Specification of what is measured, several joined by `+`; None if the adapter has no scores.
        alpha: The gate's level.
        alpha_of: What that is a share of, `chunks` or `episodes`.
        recommended: Whether `gloves tune` said what the user did not.
    """

    method: str
    gate: bool
    score: str | None
    alpha: float
    alpha_of: str
    recommended: bool = False


def settle(config: GlovesConfig, adapter: Adapter, recommendation: Recommendation | None) -> Settings:
    """What the user says, then, if no method is named, what is recommended, then the defaults.

    A recommendation is a whole: with a method that is named, nothing of it is taken.
    """
    taken = recommendation if config.method is None else None
    method = config.method or (adapter.default_editor if taken is None else taken.method)
    gate = config.gate if config.gate is not None else taken is not None and taken.gate
    # The copilot's edit is limited where a chunk looks well by itself; a gate by its correction would never limit it.
    default = next(iter(adapter.scores), None)
    if gate:
        default = getattr(adapter, "gate_score", default)
    score = config.score or (None if taken is None else taken.score) or default
    alpha = config.alpha
    if alpha is None:
        alpha = getattr(adapter, "gate_alpha", ALPHA) if taken is None else taken.alpha
    return Settings(method, gate, score, alpha, config.alpha_of, recommended=taken is not None)
