"""What holds for every task's environment alike."""

import importlib
import subprocess
import sys
from importlib.metadata import metadata
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
from lerobot.envs import EnvConfig

import lerobot_gloves.tasks  # noqa: F401
from lerobot_gloves.tasks.configuration import TaskConfig
from lerobot_gloves.tasks.panda import SimulatorError
from tests.policies.test_ddpm_assist import WITHOUT_DIFFUSERS

TASKS = {
    "gloves_slalom": ("two", {"2 0 0": "'2 0 0': give three gaps as in '0 2 3'", "023": "'023'"}),
    "gloves_keypad": ("three", {"4 0 9": "'4 0 9': give three buttons as in '4 0 8'", "4": "no code '4'"}),
    "gloves_can": ("seven", {"left": "'left': choose one of top left, top right, bottom left, bottom right"}),
    "gloves_charger": ("eight", {}),
}
"""How many numbers an action is, and wrong modes with what is said of them."""


def config(name: str) -> TaskConfig:
    return EnvConfig.get_choice_class(name)()


def test_no_task_is_left_out():
    assert TASKS.keys() == {name for name in EnvConfig.get_known_choices() if name.startswith("gloves_")}


@pytest.mark.slow
def test_the_plugin_knows_every_task_and_policies_but_one_work_where_no_extra_is_installed():
    extras = [
        "mujoco",
        "robosuite",
        "numba",
        "scipy",
        "fast_simplification",
        "mani_skill",
        "sapien",
        "diffusers",
        "ray",
    ]
    program = f"""
import sys
sys.modules |= dict.fromkeys({extras})
import lerobot_policy_gloves
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.policies import get_policy_class, make_policy_config
print(*sorted(name for name in EnvConfig.get_known_choices() if name.startswith("gloves_")))
state, action = PolicyFeature(FeatureType.STATE, (4,)), PolicyFeature(FeatureType.ACTION, (2,))
features = {{"input_features": {{"observation.state": state}}, "output_features": {{"action": action}}}}
get_policy_class("gloves_expert_flow")(make_policy_config("gloves_expert_flow", device="cpu", **features))
try:
    get_policy_class("ddpm_assist")(make_policy_config("ddpm_assist", device="cpu", **features))
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    names, *without_diffusers = done.stdout.splitlines()
    assert names.split() == sorted(TASKS)
    assert without_diffusers == [WITHOUT_DIFFUSERS]


@pytest.mark.parametrize("name", TASKS)
def test_the_environment_answers_gymnasium_as_it_promises(name):
    env = gym.make(config(name).gym_id)  # checks spaces and return types as it is used
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    env.action_space.seed(0)
    for _ in range(5):
        observation, *_ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)


@pytest.mark.parametrize("name", TASKS)
def test_seeds_begin_alike_exactly_where_the_task_says_so(name):
    known = config(name)
    env = gym.make(known.gym_id, disable_env_checker=True).unwrapped
    seeds = [10000, 10001, 10004, 10024, 10048, 10729, 10730]
    begun = {}
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        begun[seed] = env.task, *(tuple(value.ravel()) for value in observation.values())
    for one, other in combinations(seeds, 2):
        said = known.initial_state(one) is not None and known.initial_state(one) == known.initial_state(other)
        assert said == (begun[one] == begun[other]), (one, other)
    assert len({known.initial_state(seed) for seed in range(2000)}) == {"gloves_slalom": 24, "gloves_keypad": 729}.get(
        name, 1
    )


def test_a_fixed_mode_is_every_episodes_and_a_press_is_like_no_other():
    slalom, keypad = (EnvConfig.get_choice_class(f"gloves_{name}") for name in ("slalom", "keypad"))
    assert {slalom(mode="0 2 3").initial_state(seed) for seed in range(30)} == {"0 2 3"}
    assert {keypad(mode="4 0 8").initial_state(seed) for seed in range(30)} == {"4 0 8"}
    assert keypad(episode="press").initial_state(0) is None


@pytest.mark.parametrize(("name", "number"), [(name, number) for name, (number, _) in TASKS.items()])
def test_an_impossible_action_is_refused(name, number):
    env = gym.make(config(name).gym_id, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    size = env.action_space.shape[0]
    for action in ([np.nan, *[0.0] * (size - 1)], [*[0.0] * (size - 1), np.inf], [0.0] * (size - 1), [[0.0] * size]):
        with pytest.raises(ValueError, match=f"{number} finite numbers"):
            env.step(np.array(action))


@pytest.mark.parametrize("name", TASKS)
def test_unknown_options_are_refused_with_the_valid_ones(name):
    known = config(name)
    messages = {"'pixels': choose one of state, pixels_agent_pos": {"obs_type": "pixels"}}
    messages |= {message: {"mode": mode} for mode, message in TASKS[name][1].items()}
    for message, options in messages.items():
        with pytest.raises(ValueError, match=message):
            type(known)(**options)
        with pytest.raises(ValueError, match=message):
            gym.make(known.gym_id, disable_env_checker=True, **options)
    with pytest.raises(ValueError, match="20 frames a second, not 30"):
        type(known)(fps=30)


@pytest.mark.parametrize("name", sorted(TASKS.keys() - {"gloves_charger"}))  # which stands on ManiSkill
def test_a_missing_or_unusable_simulator_is_one_line_with_the_tasks_own_extra(name, monkeypatch):
    extra = name.removeprefix("gloves_")
    assert extra in metadata("lerobot_policy_gloves").get_all("Provides-Extra")
    install = rf"pip install 'lerobot_policy_gloves\[{extra}\]'"
    mujoco = importlib.import_module("mujoco")
    scene = importlib.import_module(f"lerobot_gloves.tasks.{extra}.scene")
    with monkeypatch.context() as patch:
        patch.setattr(mujoco, "__version__", "3.10.0")
        with pytest.raises(SimulatorError, match=rf"MuJoCo 3.10.0 is installed, but .* is needed: {install}$"):
            gym.make(config(name).gym_id)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "mujoco", None)  # what makes find_spec answer that there is none
        with pytest.raises(SimulatorError, match=f"^MuJoCo is not installed: {install}$"):
            gym.make(config(name).gym_id)
    build = getattr(scene, "_xml", scene.model).__wrapped__  # past the cache, which may hold the scene already
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "robosuite", None)
        with pytest.raises(
            SimulatorError, match=f"robosuite, whose Panda this task uses, is not installed: {install}$"
        ):
            build()
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "fast_simplification", None)
        with pytest.raises(ImportError, match=f"^drawing pictures needs fast-simplification: {install}$"):
            scene.model.__wrapped__(visual=True)
