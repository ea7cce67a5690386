"""Pictures of MuJoCo scenes that are drawn in one process."""

from dataclasses import dataclass, field
from functools import partial

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.spaces import Box
from lerobot.configs import PolicyFeature
from lerobot.envs import EnvConfig

from lerobot_gloves.evaluation.environments import environments, every_task
from lerobot_gloves.tasks.slalom import SlalomEnv

# Shapes of one kind in one place of each scene, so that OpenGL calls them alike.
SCENE = """<mujoco><visual><global offwidth="64" offheight="64"/></visual><asset>
<mesh name="shape" vertex="{}"/></asset><worldbody><light pos="1 1 3"/><geom type="plane" size="3 3 1"/>
<body pos="0 0 1"><joint type="hinge"/><geom type="mesh" mesh="shape" rgba="1 0 0 1"/></body></worldbody></mujoco>"""
SHAPES = {"flat": "1 1 0  -1 1 0  1 -1 0  0 0 0.1", "tall": "0.1 0 0  -0.1 0 0  0 0.1 0  0 0 2"}


class Shape(MujocoEnv):
    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 100}

    def __init__(self, file: str):
        seen = Box(0, 255, (64, 64, 3), np.uint8)
        super().__init__(file, 5, seen, render_mode="rgb_array", width=64, height=64)

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self.render()

    def step(self, action):
        return self.render(), 0.0, False, False, {}


@EnvConfig.register_subclass("shapes")
@dataclass
class ShapesEnv(EnvConfig):
    task: str | None = "flat"
    folder: str = ""
    features: dict[str, PolicyFeature] = field(default_factory=dict)

    @property
    def gym_kwargs(self) -> dict:
        return {}

    def create_envs(self, n_envs, use_async_envs=False):
        made = {name: partial(Shape, f"{self.folder}/{name}.xml") for name in self.task.split(",")}
        return {name: {0: gym.vector.SyncVectorEnv([make] * n_envs)} for name, make in made.items()}


@pytest.fixture
def folder(tmp_path) -> str:
    for name, vertices in SHAPES.items():
        (tmp_path / f"{name}.xml").write_text(SCENE.format(vertices))
    return str(tmp_path)


def frame(env) -> np.ndarray:
    return env.step(env.action_space.sample())[0][0]


def reference(folder, task) -> np.ndarray:
    """By MuJoCo's own renderer, which knows nothing of Gymnasium's."""
    model = mujoco.MjModel.from_xml_path(f"{folder}/{task}.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with environments(ShapesEnv(task=task, folder=folder), 1) as env:
        env.reset()
        camera = env.envs[0].unwrapped.mujoco_renderer.viewer.cam
        with mujoco.Renderer(model, 64, 64) as renderer:
            renderer.update_scene(data, camera)
            return renderer.render()


def test_each_scene_is_drawn_with_what_is_its_own(folder):
    alone = {task: reference(folder, task) for task in SHAPES}
    assert np.abs(alone["flat"].astype(int) - alone["tall"]).mean() > 1
    with every_task(ShapesEnv(task=",".join(SHAPES), folder=folder), 2) as envs:
        for env in envs:
            env.reset()
        for _ in range(2):
            for task, env in zip(SHAPES, envs, strict=True):
                for drawn in env.step(env.action_space.sample())[0]:
                    assert np.array_equal(drawn, alone[task])


def test_a_scene_is_drawn_as_before_when_another_is_closed(folder):
    for task in SHAPES:
        before = reference(folder, task)
        with environments(ShapesEnv(task=task, folder=folder), 1) as env:
            env.reset()
            assert np.array_equal(frame(env), before)


def test_fast_rendering_is_nearly_the_same_picture(folder):
    config = ShapesEnv(task="flat", folder=folder)
    with environments(config, 1) as env:
        env.reset()
        fine = frame(env).astype(int)
    with environments(config, 1, fast_rendering=True) as env:
        env.reset()
        coarse = frame(env)
    assert 0 < np.abs(fine - coarse).mean() < 4
    with pytest.raises(ValueError, match="'gloves_slalom' is none of Gymnasium's MuJoCo environments"):  # noqa: SIM117
        with environments(SlalomEnv(), 1, fast_rendering=True):
            pass
