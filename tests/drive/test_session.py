"""What is executed of a person's commands, beside the bare simulator and beside the adapter asked by hand."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch

from lerobot_gloves.adapter import pad
from lerobot_gloves.commands.drive import shown_in
from lerobot_gloves.drive.assistance import load_assistance
from lerobot_gloves.drive.protocol import Begin, Settings
from lerobot_gloves.drive.session import Session
from lerobot_gloves.drive.slalom import SPEED
from lerobot_gloves.drive.view import view_of
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.generators import spawn
from lerobot_gloves.system.display import Display
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_gloves.tasks.slalom.expert import SlalomExpert
from tests.builders import FLOW, calibrate, load, save_policy
from tests.policies.csa import make_csa, save_teacher
from tests.viewer import Viewer

CONFIG = SlalomEnv(episode_length=60, image_size=64)
VIEW = view_of(CONFIG)
ZERO = [0.0, 0.0]
T = FLOW["chunk_size"]


class Driven:
    """A session, and everything that its environment was given."""

    def __init__(self, env, seed: int = 1, **options):
        self.executed, self.now = [], 0.0
        step = env.step

        def noted(action):
            self.executed.append(action[0].copy())
            return step(action)

        env.step = noted
        options = {name: str(value) if name == "adapter" else value for name, value in options.items()}
        self.assistance = load_assistance(CONFIG, options, VIEW.faults, "cpu")
        self.session = Session(env, VIEW, self.assistance, seed, lambda: self.now)

    def settle(self, **changes) -> None:
        self.session.ask(dataclasses.replace(self.assistance.settings, **changes))

    def drive(self, *sticks: tuple[float, float]) -> list[dict]:
        """Hold the stick at each place for a step of 50 ms: the states."""
        states = []
        for stick in sticks:
            self.session.stick.move(*stick)
            states.append(self.session.tick().state)
            self.now += 0.05
        return states


@pytest.fixture
def env():
    with environments(CONFIG, 1) as made:
        yield made


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("checkpoints")


@pytest.fixture(scope="module")
def flow(folder):
    """An expert flow whose gate passes half of what looks like its calibration."""
    scores = {"reverse:steps=1": torch.linspace(0.0, 50.0, 99).expand(T, 99).clone()}
    return calibrate(save_policy(folder / "flow", "gloves_expert_flow", seed=7), scores=scores)


STICKS = [(1.0, 0.0), (0.5, -0.5), (0.0, 1.0), (0.0, 0.0), (-0.3, 0.2)] * 3


def test_without_assistance_the_command_is_executed_scaled_and_nothing_else(env, flow):
    driven = Driven(env, adapter=flow)
    driven.settle(assistance="off")
    states = driven.drive(*STICKS)
    expected = [np.float32([-SPEED * y, SPEED * x]) for x, y in STICKS]
    np.testing.assert_array_equal(driven.executed, expected)
    bare = gym.make("gloves/Slalom-v0").unwrapped
    bare.reset(seed=1)
    for action, state in zip(expected, states, strict=True):
        tip = bare.step(action)[0]["agent_pos"][2:]
        assert state["place"] == (float(tip[1]), float(tip[0])) and not state["edited"]
    assert [state["step"] for state in states] == list(range(1, 16))
    assert [state["time"] for state in states] == pytest.approx([0.05 * i for i in range(15)])
    assert any(0 < state["p"] <= 1 for state in states if any(state["sent"]))  # the gate says what it thinks
    np.testing.assert_allclose([state["executed"][:2] for state in states], STICKS, atol=1e-6)


def test_a_display_is_told_command_executed_action_score_and_p_value(env, flow, monkeypatch):
    viewer, driven = Viewer(monkeypatch), Driven(env, adapter=flow, method="feeg:start=0.5")
    driven.settle(assistance="gate", alpha=0.5)
    driven.session.watchers.append(shown_in(Display()))
    states = driven.drive(*STICKS)
    acted = [step["action"] for step in viewer.shown]
    assert [one["proposed"].tolist() for one in acted] == [VIEW.steer(*stick).tolist() for stick in STICKS]
    np.testing.assert_array_equal([one["executed"] for one in acted], driven.executed)
    told = [step["observation"] for step in viewer.shown]
    moved = [any(state["sent"]) for state in states]
    assert [one.get("gloves.p_value") for one in told] == [state["p"] for state in states]
    assert ["gloves.score" in one for one in told] == moved and all("observation.state" in one for one in told)


@pytest.mark.parametrize(("told", "level"), [({}, 0.2), ({"alpha": 0.3}, 0.3)])
def test_it_begins_at_the_level_that_is_named_or_else_at_its_adapters_own(env, folder, told, level):
    adapter = folder / "copilot_with_a_level"
    if not adapter.exists():
        save_policy(adapter, "gloves_copilot", seed=7, gate_score="reverse:steps=1", gate_alpha=0.2)
        calibrate(adapter, scores={"reverse:steps=1": torch.linspace(0.0, 50.0, 99).expand(T, 99).clone()})
    assert Driven(env, adapter=adapter, **told).assistance.settings.alpha == level


@pytest.mark.parametrize("kind", ["gloves_expert_flow", "gloves_copilot", "ddpm_assist", "csa_assist"])
def test_with_assistance_it_is_the_adapters_own_edit_of_the_held_command(env, folder, kind):
    method = {"method": "feeg"} if kind == "gloves_copilot" else {}  # its own edit needs a calibration
    own = {"num_inference_steps": None} if kind == "ddpm_assist" else {}
    options = {} if kind == "gloves_copilot" else {**FLOW, **own}
    student = make_csa(stage="student", teacher=str(save_teacher(folder / "teacher"))) if kind == "csa_assist" else None
    adapter = save_policy(folder / f"always_{kind}", kind, seed=7, policy=student, **options)
    driven = Driven(env, adapter=adapter, **method)
    assert driven.assistance.settings.assistance == "always" and driven.assistance.ungated
    policy, (preprocess, postprocess) = load(adapter)
    editor = policy.editors[method.get("method", policy.default_editor)]()
    history, proposals, generator = getattr(policy, "history", 0), [], []
    for x, y in [(1.0, 0.0), (0.0, -1.0), (0.5, 0.5)]:
        seen = {key: torch.from_numpy(value).float() for key, value in driven.session._observation.items()}
        (state,) = driven.drive((x, y))
        generator = generator or spawn(0, 1, first_episode=0, stream="editor")
        held = pad(torch.tensor([[[-SPEED * y, SPEED * x]]]), T)
        read = [*proposals[len(proposals) - min(history, len(proposals)) :], held]
        proposals.append(held)
        inputs = {"observation.state": seen["agent_pos"], "observation.environment_state": seen["environment_state"]}
        batch = preprocess(
            {
                **{key: value[None] if value.ndim == 1 else value for key, value in inputs.items()},
                "action": torch.stack(read, dim=1),
            }
        )
        *past, chunk = batch["action"].unbind(dim=1)
        bound = policy.bind(batch, *([torch.stack(past, dim=1) if past else None] if history else []))
        score = next((one() for one in policy.scores.values()), None)
        edited = bound.edit(chunk, editor, score=score, threshold=None, length=T, generator=generator)
        expected = postprocess(edited)[0, 0]
        np.testing.assert_allclose(driven.executed[-1], expected, rtol=1e-4, atol=1e-6)
        assert state["edited"] and state["p"] is None and np.abs(driven.executed[-1] - held[0, 0].numpy()).max() > 1e-5


def test_the_gate_admits_bit_for_bit_and_edits_the_rest(env, flow):
    driven = Driven(env, adapter=flow)
    driven.settle(assistance="gate", alpha=0.3)
    rng = np.random.default_rng(0)
    sticks = [tuple(rng.uniform(-1, 1, 2)) for _ in range(40)]
    states = driven.drive(*sticks)
    assert {state["edited"] for state in states} == {True, False}
    for (x, y), state, executed in zip(sticks, states, driven.executed, strict=False):
        assert state["edited"] == (state["p"] <= 0.3)
        assert np.array_equal(executed, VIEW.steer(x, y)) != state["edited"]


def test_who_commands_nothing_stands_still_whatever_assistance_and_fault(env, flow):
    driven = Driven(env, adapter=flow)
    for fault in VIEW.faults:
        driven.session.ask(Begin("again"))
        driven.settle(assistance="always", fault=fault)
        driven.drive((0.6, 0.6), (0.6, 0.6))
        moved = len(driven.executed)
        driven.drive(*[(0.0, 0.0)] * 10)
        np.testing.assert_array_equal(driven.executed[moved:], [ZERO] * 10)


def test_without_a_command_for_300_ms_the_robot_stands_still_and_time_goes_on(env):
    driven = Driven(env)
    driven.drive((1.0, 0.0))
    for _ in range(9):
        state = driven.session.tick().state
        driven.now += 0.05
    assert state["step"] == 10 and state["phase"] == "driving"
    # Of the ten steps at 0, 50, ... ms the first six are less than 300 ms after the command.
    np.testing.assert_array_equal(driven.executed, [VIEW.steer(1.0, 0.0)] * 6 + [ZERO] * 4)


def test_an_episode_begins_with_the_first_command_and_ends_by_time(env):
    driven = Driven(env)
    assert [state["phase"] for state in driven.drive((0.0, 0.0), (0.0, 0.0))] == ["ready", "ready"]
    states = driven.drive(*[(0.0, 0.1), (0.0, -0.1)] * 31)
    assert states[0]["phase"] == "driving" and states[59]["ending"] == "The time is up."
    assert {state["phase"] for state in states[59:]} == {"failure"} and states[-1]["step"] == 60
    assert len(driven.executed) == 60 and len(driven.session.tick().trail) == 61


def test_a_corridor_is_completed_by_commands():
    expert = SlalomExpert(np.random.default_rng(0))
    with environments(SlalomEnv(image_size=64), 1) as env:
        driven = Driven(env, seed=5)
        expert.reset("0 1 1")
        for _ in range(300):
            seen = {key: value[0] for key, value in driven.session._observation.items()}
            right, up, _ = VIEW.arrow(expert.act(seen))
            (state,) = driven.drive((min(max(right, -1), 1), min(max(up, -1), 1)))
            if state["phase"] != "driving":
                break
        assert state["phase"] == "success" and state["place"][0] > 0.35
        trail = driven.session.tick().trail
        rows = [min(trail, key=lambda point: abs(point[0] - row))[1] for row, _ in VIEW.targets("0 1 1")]
        np.testing.assert_allclose(rows, [down for _, down in VIEW.targets("0 1 1")], atol=0.03)


def test_again_is_the_same_corridor_and_next_another_one(env):
    driven = Driven(env, seed=5)
    tasks = []
    for episode in ("again", "again", "next", "next", "next"):
        driven.session.ask(Begin(episode))
        tasks.append(driven.session.tick().about["task"])
    assert tasks[0] == tasks[1] == "0 1 1" and len(set(tasks)) > 2  # seed 5 is the sixth of the 24 corridors


def test_an_edit_goes_no_further_than_the_limit(env, flow):
    driven = Driven(env, adapter=flow)
    driven.settle(assistance="always", limit=0.1)
    states = driven.drive(*STICKS[:3])
    moved = np.abs(np.array(driven.executed) - [VIEW.steer(*stick) for stick in STICKS[:3]])
    assert all(state["edited"] for state in states) and 0 < moved.max() <= 0.1 * 0.01 + 1e-8
    driven.settle(limit=0)
    driven.drive((1.0, 0.0))
    np.testing.assert_allclose(driven.executed[-1], VIEW.steer(1.0, 0.0), atol=1e-9)


def test_a_fault_does_to_commands_what_the_perturbation_does(env):
    driven = Driven(env)
    driven.settle(fault="shift")
    driven.drive((0.5, 0.0))
    np.testing.assert_allclose(driven.executed[-1], VIEW.steer(0.5, 0.0) + np.float32([0.003, 0]), atol=1e-9)
    driven.settle(fault="late by 0.2 s")
    driven.drive(*[(1.0, 0.0)] * 2, *[(0.0, 1.0)] * 5)
    late = [VIEW.steer(1.0, 0.0)] * 6 + [VIEW.steer(0.0, 1.0)]
    np.testing.assert_array_equal(driven.executed[1:], late)
    driven.settle(fault="none")
    driven.drive((0.5, 0.0))
    np.testing.assert_array_equal(driven.executed[-1], VIEW.steer(0.5, 0.0))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"fault": "earthquake"}, "there is no fault 'earthquake': choose from none, laggy link"),
        ({"assistance": "gate", "alpha": 0.001}, "alpha is 0.001, but with 99 calibration chunks"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_one_line_and_change_nothing(env, flow, changes, told):
    driven = Driven(env, adapter=flow)
    before = driven.assistance.settings
    driven.settle(**changes)
    (state,) = driven.drive((0.1, 0.0))
    assert told in state["notice"] and "\n" not in state["notice"] and driven.assistance.settings == before


def test_without_an_adapter_nothing_assists(env):
    driven = Driven(env)
    assert driven.assistance.settings == Settings("off", 0.05, 2.0, "none")
    driven.settle(assistance="always")
    (state,) = driven.drive((0.1, 0.0))
    assert state["notice"] == "there is no adapter, so nothing can assist: name one by --policy.adapter"


def test_the_robot_stands_still_where_the_editor_returns_nan(env, flow, monkeypatch):
    driven = Driven(env, adapter=flow)
    driven.settle(assistance="always")
    monkeypatch.setattr(driven.assistance._policy._corrector.loaded, "postprocess", lambda chunk: chunk * torch.nan)
    (state,) = driven.drive((1.0, 0.0))
    assert "the editor returned a non-finite action" in state["notice"]
    np.testing.assert_array_equal(driven.executed, [ZERO])
