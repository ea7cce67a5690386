"""ManiSkill, quietly, and without a graphics driver where nothing is drawn."""

import gc
import importlib.util
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lerobot_gloves.tasks.panda import SimulatorError

RENDERING_CLASSES = ("RenderMaterial", "RenderTexture2D")


def import_plug_charger() -> Any:
    """The class of ManiSkill's PlugCharger-v1.

    Raises:
        SimulatorError: If ManiSkill is missing or cannot be imported.
    """
    if importlib.util.find_spec("mani_skill") is None or importlib.util.find_spec("sapien") is None:
        raise SimulatorError("ManiSkill is not installed: pip install 'lerobot_policy_gloves[charger]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # hints about graphics drivers, and deprecations in what ManiSkill imports
        try:
            from mani_skill.envs.tasks import PlugChargerEnv
        except Exception as error:
            raise SimulatorError(
                f"ManiSkill cannot be imported ({error}): pip install 'lerobot_policy_gloves[charger]'"
            ) from error
    return PlugChargerEnv


def plug_charger(**options: Any) -> Any:
    """ManiSkill's PlugCharger-v1 with this task's control, on one CPU core, without Gymnasium's wrappers.

    Args:
        options: Further arguments of ManiSkill's environments.
    """
    with warnings.catch_warnings(), _nothing_to_collect():
        warnings.simplefilter("ignore")
        return import_plug_charger()(
            control_mode="pd_joint_delta_pos", reward_mode="sparse", sim_backend="physx_cpu", **options
        )


@contextmanager
def _nothing_to_collect() -> Iterator[None]:
    """Within it a garbage collection sees only what is new.

    ManiSkill asks for one before it builds a scene, to free a GPU's memory. Beside all that LeRobot imports it takes
    0.3 seconds, ten times as long as the scene.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class _Inert:
    """Stands in for a material or a texture: takes every setting and keeps none."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        pass

    def __getattr__(self, name: str) -> Any:
        if name.startswith("set_"):
            return lambda *arguments, **settings: None
        raise AttributeError(name)


@contextmanager
def without_graphics() -> Iterator[None]:
    """Within it ManiSkill builds scenes to move in, not to draw, on a machine with no Vulkan driver at all.

    ManiSkill makes a material for everything it loads, even with rendering off, and SAPIEN makes none without a
    driver. Nothing else in a scene asks for one.
    """
    import_plug_charger()  # quietly
    import sapien
    import sapien.wrapper.urdf_loader as urdf_loader

    modules = (sapien.render, sapien.pysapien.render, urdf_loader)
    places = [(module, name) for module in modules for name in RENDERING_CLASSES if hasattr(module, name)]
    classes = [getattr(module, name) for module, name in places]
    for module, name in places:
        setattr(module, name, _Inert)
    try:
        yield
    finally:
        for (module, name), class_ in zip(places, classes, strict=True):
            setattr(module, name, class_)
