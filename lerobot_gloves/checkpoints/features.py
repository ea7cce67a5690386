"""Whether what one gives is what another needs: features of datasets, environments, agents and adapters."""

import math
from collections.abc import Mapping

from lerobot.configs import FeatureType, PolicyFeature

type Features = Mapping[str, PolicyFeature]


def check_features(
    who: str, needed: Features, giver: str, given: Features, *, images: bool = True, advice: str = ""
) -> None:
    """Refuse what lacks a feature, or has it in another shape; images may have another size.

    Args:
        who: Whoever needs them, such as "the adapter".
        needed: Its features under LeRobot's keys.
        giver: Whoever has them, such as a dataset's name.
        given: What that has.
        images: Whether images are compared at all.
        advice: What to do about it.

    Raises:
        ValueError: Naming what is missing, and what there is.
    """
    compared = {key: one for key, one in needed.items() if images or one.type is not FeatureType.VISUAL}
    if lacking := {key: one for key, one in compared.items() if not _has(given, key, one)}:
        raise ValueError(
            f"{who} needs {described(lacking)}, but {giver} has {described(given)}{advice and ': '}{advice}"
        )


SAME_RATE = """--policy.adapter_overrides='["--fps=null"]'"""
"""The wrapper's option that says that an adapter's rate is not to be compared."""


def check_rate(needed: float | None, giver: str, given: float | None, override: str) -> None:
    """Refuse data or a loop of another rate than the adapter's; a chunk is then another stretch of time.

    Args:
        needed: Frames a second of what the adapter was trained on; None where it does not say.
        giver: Whoever runs at another one, such as a dataset's name.
        given: Its frames a second; None where nobody knows.
        override: The option that says to take them for the same.

    Raises:
        ValueError: If both are known and differ by more than a hundredth.
    """
    if needed and given and not math.isclose(needed, given, rel_tol=0.01):
        raise ValueError(
            f"the adapter was trained on {needed:g} frames a second, but {giver} has {given:g}: take one of the same "
            f"rate, or, if that figure is wrong, {override}"
        )


def described(features: Features) -> str:
    """Features with their shapes, for people."""
    return ", ".join(f"{key} {tuple(one.shape)}" for key, one in sorted(features.items())) or "nothing"


def _has(given: Features, key: str, needed: PolicyFeature) -> bool:
    if key not in given:
        return False
    return needed.type is FeatureType.VISUAL or tuple(needed.shape) == tuple(given[key].shape)
