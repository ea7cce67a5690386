"""What Charger's simulator leaves in memory."""

import gc
import weakref

from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.tasks.charger import ChargerEnv
from lerobot_gloves.tasks.charger.environment import Charger


def test_making_one_searches_nothing_old_for_garbage():
    """ManiSkill's own collection would take longer than all else; a later one sees everything again."""
    seen = []

    def note(phase, info):
        if phase == "start" and info["generation"] == 2:
            seen.append(len(gc.get_objects()))

    gc.collect()
    before = len(gc.get_objects())
    gc.callbacks.append(note)
    try:
        Charger().close()
    finally:
        gc.callbacks.remove(note)
    assert seen and min(seen) < before / 10
    assert len(gc.get_objects()) > before / 2


def test_a_benchmarks_last_environments_are_gone_when_the_next_are_made():
    """Python would collect them at some time; until then each cell's simulators would lie beside the next one's."""
    gc.disable()
    try:
        with environments(ChargerEnv(), 1) as envs:
            last = weakref.ref(envs.envs[0].unwrapped._scene)
        del envs
        with environments(ChargerEnv(), 1):
            assert last() is None
    finally:
        gc.enable()
