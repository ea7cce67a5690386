"""Whether what one gives is what another needs: features of datasets, environments, agents and adapters."""

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


def described(features: Features) -> str:
    """Features with their shapes, for people."""
    return ", ".join(f"{key} {tuple(one.shape)}" for key, one in sorted(features.items())) or "nothing"


def _has(given: Features, key: str, needed: PolicyFeature) -> bool:
    if key not in given:
        return False
    return needed.type is FeatureType.VISUAL or tuple(needed.shape) == tuple(given[key].shape)
