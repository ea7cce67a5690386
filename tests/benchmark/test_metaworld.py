"""MetaWorld, as LeRobot has it, played by LeRobot's own agents and corrected, all trained on smaller images."""

from dataclasses import replace

import pytest
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import MetaworldEnv

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.dry_run import try_all
from lerobot_gloves.benchmark.plan import plan
from lerobot_gloves.benchmark.play import run
from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.checkpoints.image_size import resize_images
from tests.builders import save_policy
from tests.metaworld import draw
from tests.policies.agents import saved_agent

FEATURES = {
    "input_features": {
        "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
        "observation.image": PolicyFeature(FeatureType.VISUAL, (3, 64, 64)),
    },
    "output_features": {"action": PolicyFeature(FeatureType.ACTION, (4,))},
}
STEPS = 12


@pytest.fixture
def drawn(monkeypatch) -> list[object]:
    """The environments that have drawn a picture, as often as they did."""
    from lerobot.envs.metaworld import MetaworldEnv as Simulation

    frames: list[object] = []

    def note(renderer, *arguments, **options):
        frames.append(renderer)
        return draw(renderer)

    monkeypatch.setattr(MujocoRenderer, "render", note)
    monkeypatch.setattr(Simulation, "_max_episode_steps", property(lambda _: STEPS, lambda *_: None), raising=False)
    return frames


@pytest.mark.parametrize(("kind", "looks"), [("act", 4), ("diffusion", 7), ("multi_task_dit", 7)])
def test_stock_agents_are_corrected_and_only_what_is_looked_at_is_drawn(tmp_path, drawn, monkeypatch, kind, looks):
    """An agent acts on 4 actions at a time, for which an adapter of 6 sees it once; two also look a step back."""
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", **FEATURES)
    with saved_agent(tmp_path, kind, n_action_steps=4, **FEATURES) as agent:
        resize_images(agent)
        setup = Setup(env=MetaworldEnv(task="reach-v3"), agent=str(agent), adapter=str(adapter), episodes=1)
        cell = Cell("none", "feeg:start=0.5", 0)
        try_all(plan([(setup, cell)]))
        drawn.clear()
        (episode,) = run(setup, cell)
        # The first frame, then those before a new chunk, such as one behind the last step, where no chunk is made.
        assert len(drawn) == looks
        assert (episode.steps, episode.chunks, episode.edited) == (STEPS, 3, 3)
        monkeypatch.setattr("lerobot_gloves.evaluation.rollout.draw_only", lambda *_: None)
        drawn.clear()
        (everything,) = run(setup, cell)
        assert len(drawn) == STEPS + 1
        assert replace(everything, milliseconds=0.0) == replace(episode, milliseconds=0.0)


def test_how_it_was_drawn_is_noted_in_the_rows(tmp_path):
    agent = save_policy(tmp_path / "agent", "gloves_expert_flow", **FEATURES)
    setup = Setup(env=MetaworldEnv(task="reach-v3"), agent=str(agent), fast_rendering=True)
    cell = Cell("none", "none", 0)
    (fast,), (usual,) = plan([(setup, cell)]), plan([(replace(setup, fast_rendering=False), cell)])
    assert fast.conditions["env"] == {**usual.conditions["env"], "fast_rendering": True}
