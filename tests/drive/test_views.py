"""Keypad and CAN under a person's hands: what keys do, what the page is told."""

import numpy as np
import pytest

from lerobot_gloves.drive.assistance import load_assistance
from lerobot_gloves.drive.session import Session
from lerobot_gloves.drive.view import VIEWS, view_of
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.tasks.can import CanEnv
from lerobot_gloves.tasks.keypad import KeypadEnv
from lerobot_gloves.tasks.keypad.expert import KeypadExpert
from lerobot_gloves.tasks.keypad.scene import BUTTONS
from lerobot_gloves.tasks.slalom import SlalomEnv

CONFIGS = [SlalomEnv(), KeypadEnv(), CanEnv()]


def session_of(config, env, seed: int) -> Session:
    view = view_of(config)
    return Session(env, view, load_assistance(config, {}, view.faults, "cpu"), seed, lambda: 0.0)


def shown(session: Session) -> dict:
    return {key: value[0] for key, value in session._observation.items()}


@pytest.mark.parametrize("config", CONFIGS, ids=lambda config: config.type)
def test_the_arrow_of_an_action_is_the_stick_that_steers_to_it(config):
    view = view_of(config)
    for stick in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-0.6, 0.3, 0.5)):
        action = view.steer(*stick)
        assert action.dtype == np.float32 and action.shape == config.features["action"].shape
        found = view.arrow(action)
        height = stick[2] if "height" in view.scene["keys"] else 0.0
        assert found == pytest.approx((*stick[:2], height), abs=1e-6)


def test_every_view_is_of_a_task():
    assert set(VIEWS) == {config.type for config in CONFIGS}


def test_a_button_is_pressed_by_commands_and_the_page_is_told_which_is_due():
    config = KeypadEnv(episode="press", mode="5", image_size=64)
    expert = KeypadExpert(np.random.default_rng(0))
    with environments(config, 1) as env:
        session = session_of(config, env, 0)
        expert.reset("5")
        for _ in range(200):
            session.stick.move(*np.clip(session._view.arrow(expert.act(shown(session))), -1, 1).tolist())
            state = session.tick().state
            if state["phase"] != "driving":
                break
            assert state["due"] == [BUTTONS[5][1], BUTTONS[5][0]]
            assert state["height"] == shown(session)["agent_pos"][2]
        about = session.tick().about
    assert state["phase"] == "success" and state["place"] == pytest.approx((0.05, 0.5), abs=0.016)
    assert about["targets"] == [(0.05, 0.5)] and "Press button 5, counted" in about["words"]


def test_fingers_close_and_open_while_the_hand_stands_still():
    config = CanEnv(image_size=64, mode="bottom left")
    with environments(config, 1) as env:
        session = session_of(config, env, 0)
        assert "bottom left" in session.tick().about["words"]
        session.stick.move(0.0, 0.0, 0.0, 1.0)
        assert session.tick().state["phase"] == "ready"  # an episode begins with a movement
        session.stick.move(0.0, 0.0, 1.0, -1.0)
        before = session.tick().state["height"]
        for _ in range(3):
            state = session.tick().state
        assert state["height"] > before + 0.02
        widths = []
        for grip in (-1.0, 1.0, 0.0):
            session.stick.move(0.0, 0.0, 0.0, grip)
            for _ in range(25):
                state = session.tick().state
            widths.append(shown(session)["agent_pos"][7])
            assert state["executed"] == (0.0, 0.0, 0.0)
    assert widths[0] > 0.07 and widths[1] < 0.01
    assert widths[2] == pytest.approx(widths[1], abs=1e-3)  # who lets go of everything leaves them as they are
    x, y, _ = shown(session)["environment_state"][:3]
    assert state["objects"][0][:2] == [y, x]
