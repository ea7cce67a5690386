"""What LeRobot's viewer is told of a step."""

import numpy as np
import pytest
import torch

from lerobot_gloves.system.display import Display
from tests.viewer import Viewer

BATCH = {
    "observation.state": torch.tensor([[0.5, -1.0], [7.0, 7.0]]),
    "observation.images.front": torch.tensor([0.0, 0.5, 1.0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 5),
    "task": ["left", "right"],
}


def show(display: Display) -> None:
    display.show(BATCH, torch.tensor([[0.25], [9.0]]), torch.tensor([[0.5], [9.0]]), {"p_value": 0.125})


def test_numbers_and_pictures_of_the_first_environment_are_shown(monkeypatch):
    viewer = Viewer(monkeypatch)
    show(Display())
    (told,) = viewer.shown
    seen, acted = told["observation"], told["action"]
    assert set(seen) == {"observation.state", "observation.images.front", "gloves.p_value"}
    assert seen["observation.state"].tolist() == [0.5, -1.0] and seen["gloves.p_value"] == 0.125
    picture = seen["observation.images.front"]
    assert picture.dtype == np.uint8 and picture.shape == (3, 4, 5) and picture[:, 2, 3].tolist() == [0, 128, 255]
    assert {name: value.tolist() for name, value in acted.items()} == {"proposed": [0.25], "executed": [0.5]}


def test_the_viewer_is_opened_once_where_it_was_asked_for(monkeypatch):
    viewer = Viewer(monkeypatch)
    display = Display("192.0.2.7", 9876)
    assert not viewer.opened
    show(display)
    show(display)
    assert viewer.opened == [{"mode": "rerun", "session_name": "gloves", "ip": "192.0.2.7", "port": 9876}]


def test_a_viewer_that_the_program_has_is_used(monkeypatch):
    viewer = Viewer(monkeypatch)
    viewer.running = object()
    show(Display())
    assert len(viewer.shown) == 1 and not viewer.opened


def test_an_address_without_a_port_is_refused():
    with pytest.raises(ValueError, match="give both display_ip and display_port"):
        Display(ip="192.0.2.7")
