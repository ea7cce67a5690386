"""`gloves teleoperate` and `gloves record --teleop...` on a toy robot with a toy leader."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.processor import ProcessorStepRegistry
from lerobot.scripts import lerobot_record, lerobot_teleoperate
from lerobot.utils.constants import DEFAULT_FEATURES
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_gloves.adapter import pad
from lerobot_gloves.commands import main, teleoperate
from lerobot_gloves.drive import held_key
from lerobot_gloves.drive.held_key import HeldKey
from lerobot_gloves.editors import FEEG
from lerobot_gloves.generators import spawn
from tests.builders import FLOW, calibrate, load, save_policy, statistics
from tests.policies.toyleader import TOY, ToyLeader
from tests.policies.toyrobot import INPUTS, OUTPUTS, ToyRobot

FREE = ("--limits.key=null", "--limits.edit=null")
RANGE = statistics({**INPUTS, **OUTPUTS})["action"]
METHOD = "--policy.method=feeg:start=0.3"


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adapter") / "flow"
    return save_policy(folder, "gloves_expert_flow", **FLOW, input_features=INPUTS, output_features=OUTPUTS)


@pytest.fixture
def operate(monkeypatch, flow):
    """Run `gloves teleoperate` for ten steps with some options; what was commanded and what the robot got."""

    def run(*options: str, adapter=flow) -> tuple[np.ndarray, np.ndarray]:
        corrected = [] if adapter is None else [f"--policy.adapter={adapter}"]
        monkeypatch.setattr("sys.argv", ["gloves", "teleoperate", *TOY, "--fps=500", *corrected, *options])
        main()
        return np.array(ToyLeader.commanded), np.array(ToyRobot.sent)

    return run


@pytest.fixture
def key(monkeypatch):
    """A dead man's key that is held by hand."""
    held = []

    class Key(HeldKey):
        def __init__(self, name: str):
            self._key, self._held, self._listener = name, False, SimpleNamespace(running=True)
            held.append(self)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self._listener.running = False

    monkeypatch.setattr(teleoperate, "HeldKey", Key)
    return held


def test_what_is_not_edited_is_executed_bit_for_bit_as_by_lerobots_own_command(operate, typed):
    commanded, executed = operate("--policy.method=none", *FREE)
    assert executed.shape == (10, 2) and np.array_equal(executed, commanded)
    typed(*TOY, "--fps=500")
    lerobot_teleoperate.teleoperate()
    assert np.array_equal(ToyRobot.sent, executed)


def test_every_command_is_edited_as_the_adapter_edits_the_command_held(operate, flow):
    commanded, executed = operate(METHOD, "--policy.gate=false", *FREE)
    policy, (preprocess, postprocess) = load(flow)
    joints, generator = torch.tensor([0.3, -0.2], dtype=torch.float64), spawn(0, 1, first_episode=0, stream="editor")
    low, high = (torch.as_tensor(RANGE[name]) for name in ("min", "max"))
    for command, sent in zip(commanded, executed, strict=True):
        held = pad(torch.tensor(command, dtype=torch.float32)[None, None], FLOW["chunk_size"])
        batch = preprocess({"observation.state": joints.float()[None], "action": held})
        edited = policy.bind(batch).edit(
            batch["action"], FEEG(start=0.3), score=None, threshold=None, length=FLOW["chunk_size"], generator=generator
        )
        expected = postprocess(edited)[0, 0].clamp(low, high)
        np.testing.assert_allclose(sent, expected, rtol=1e-4, atol=1e-6)
        joints += 0.5 * torch.tensor(sent)
    assert np.abs(executed - commanded).max() > 1e-3


def test_an_edit_goes_a_tenth_of_the_demonstrated_range_unless_more_is_allowed(operate, key):
    ranges = RANGE["max"] - RANGE["min"]
    commanded, far = operate(METHOD, "--policy.gate=false", *FREE)
    share = (np.abs(far - commanded) / ranges).max()
    assert share > 0.1
    commanded, near = operate(METHOD, "--policy.gate=false", "--limits.key=null")
    assert (np.abs(near - commanded) / ranges).max() == pytest.approx(0.1, rel=1e-3)
    commanded, left = operate(METHOD, "--policy.gate=false", "--limits.key=null", "--limits.edit=0")
    assert np.array_equal(left, commanded)


def test_assistance_acts_while_the_dead_mans_key_is_held(operate, key, monkeypatch):
    step = ToyLeader.get_action

    def pressed(leader):
        (key[0]._press if len(ToyLeader.commanded) in (3, 4, 5) else key[0]._release)("space")
        return step(leader)

    monkeypatch.setattr(ToyLeader, "get_action", pressed)
    commanded, executed = operate(METHOD, "--policy.gate=false")
    assert (executed != commanded).any(axis=1).nonzero()[0].tolist() == [3, 4, 5]
    assert [one._key for one in key] == ["space"] and not key[0]()


def test_a_key_is_held_from_its_press_to_its_release(monkeypatch):
    made = []

    class Listener:
        running = False

        def __init__(self, on_press, on_release):
            self.press, self.release = on_press, on_release
            made.append(self)

        def start(self):
            self.running = True

        def stop(self):
            self.running = False

    keys = SimpleNamespace(from_char=lambda name: ("char", name))
    named = type("Key", (), {"space": "space", "__iter__": None})
    keyboard = SimpleNamespace(KeyCode=keys, Key=named, Listener=Listener)
    monkeypatch.setitem(sys.modules, "pynput", SimpleNamespace(keyboard=keyboard))
    monkeypatch.setattr(held_key, "pynput_can_capture", lambda: True)
    with HeldKey("x") as held:
        heard = made[0]
        told = [held()]
        for event, name in [("press", "y"), ("press", "x"), ("press", "x"), ("release", "y"), ("release", "x")]:
            getattr(heard, event)(("char", name))
            told.append(held())
        assert told == [False, False, True, True, True, False]
        heard.press(("char", "x"))
        heard.stop()
        assert not held()


def test_the_gate_passes_commands_bit_for_bit_and_is_on_where_there_is_one(operate, tmp_path):
    flow = save_policy(tmp_path / "flow", "gloves_expert_flow", **FLOW, input_features=INPUTS, output_features=OUTPUTS)
    calibrate(flow)
    log = tmp_path / "log.jsonl"
    commanded, executed = operate(METHOD, "--policy.alpha=0.5", f"--policy.log={log}", *FREE, adapter=flow)
    lines = [eval(line, {"true": True, "false": False, "null": None}) for line in log.read_text().splitlines()]
    assert [line["p_value"] is not None for line in lines] == [True] * 10
    for line, command, sent in zip(lines, commanded, executed, strict=True):
        assert line["edited"] == (line["p_value"] <= 0.5) == bool((sent != command).any())


def test_the_robot_goes_on_by_hand_where_the_editor_returns_nan(operate, monkeypatch, caplog):
    made = ProcessorStepRegistry.get("gloves_correction")
    begin = made.__post_init__

    def broken(step):
        begin(step)
        step._policy._corrector.loaded.postprocess = lambda chunk: chunk * torch.nan

    monkeypatch.setattr(made, "__post_init__", broken)
    commanded, executed = operate(METHOD, "--policy.gate=false", *FREE)
    assert np.array_equal(executed, commanded)


def test_a_display_is_told_command_score_and_p_value(operate, monkeypatch):
    shown = []
    monkeypatch.setattr(lerobot_teleoperate, "init_visualization", lambda *_, **__: None)
    monkeypatch.setattr(lerobot_teleoperate, "shutdown_visualization", lambda *_: None)
    monkeypatch.setattr(lerobot_teleoperate, "log_visualization_data", lambda mode, **data: shown.append(data))
    commanded, executed = operate(METHOD, "--policy.gate=false", "--display_data=true", *FREE)
    told = [[data["observation"][f"gloves.commanded.{joint}"] for joint in data["action"]] for data in shown]
    np.testing.assert_allclose(told, commanded, rtol=1e-6)
    assert np.array_equal([list(data["action"].values()) for data in shown], executed)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--policy.adapter=ADAPTER"], "the dead man's key needs a keyboard of which a program is told what is let go"),
        (["--limits.key=null"], "nothing would correct: name an adapter by --policy.adapter"),
        (["--limits.key=null", "--policy.adapter=ADAPTER", "--limits.edit=2"], "limit is 2.0, but must lie between"),
        (["--limits.key=null", "--policy.adapter=nowhere"], "--policy.adapter=nowhere is no checkpoint"),
        (["--limits.key=null", "--policy.adapter=ADAPTER", "--teleop.joints=[elbow.pos]"], "commands shoulder.pos"),
    ],
)
def test_what_cannot_be_is_told_in_one_line_and_the_robot_gets_nothing(monkeypatch, flow, options, told):
    monkeypatch.setattr(ToyRobot, "sent", [])
    words = [option.replace("ADAPTER", str(flow)) for option in options]
    monkeypatch.setattr("sys.argv", ["gloves", "teleoperate", *TOY, *words])
    with pytest.raises(SystemExit) as error:
        main()
    assert str(error.value).startswith("gloves teleoperate: ") and told in str(error.value)
    assert "\n" not in str(error.value) and ToyRobot.sent == []


def test_a_command_that_is_not_finite_is_never_executed(operate, monkeypatch):
    monkeypatch.setattr(ToyLeader, "script", [[0.1, 0.2], [float("nan"), 0.0]])
    with pytest.raises(SystemExit, match=r"the teleoperator commands \[nan, 0.0\], which is not finite"):
        operate(METHOD, *FREE)
    assert len(ToyRobot.sent) == 1


def test_a_recording_holds_what_was_commanded_and_what_was_executed(flow, monkeypatch, tmp_path):
    root, sent, commanded, resumed = tmp_path / "dataset", [], [], []
    options = [
        *("--robot.steps=100000", f"--policy.adapter={flow}", METHOD, "--policy.gate=false", "--limits.key=null"),
        *("--dataset.repo_id=me/toy", f"--dataset.root={root}", "--dataset.single_task=move", "--dataset.fps=100"),
        *("--dataset.episode_time_s=0.3", "--dataset.reset_time_s=0", "--dataset.push_to_hub=false"),
        *("--play_sounds=false", "--dataset.no_stamp=true"),
    ]
    # LeRobot's own check of what is resumed, without the package that finds the differences for it.
    monkeypatch.setattr(
        lerobot_record,
        "sanity_check_dataset_robot_compatibility",
        lambda dataset, robot, fps, features: resumed.append(dataset.features == {**features, **DEFAULT_FEATURES}),
    )
    for more in (["--dataset.num_episodes=2"], ["--dataset.num_episodes=1", "--resume=true"]):
        monkeypatch.setattr("sys.argv", ["gloves", "record", *TOY, *options, *more])
        main()
        sent, commanded = sent + ToyRobot.sent, commanded + ToyLeader.commanded
    recorded = LeRobotDataset("me/toy", root=root)
    columns = {name: np.stack(recorded.hf_dataset[name]) for name in recorded.features}
    assert resumed == [True] and recorded.num_episodes == 3 and recorded.num_frames == len(sent) >= 3
    np.testing.assert_array_equal(columns["action"], np.float32(sent))
    np.testing.assert_array_equal(columns["commanded"], np.float32(commanded))
    assert columns["edited"].all() and (columns["action"] != columns["commanded"]).any(axis=1).all()
    assert dataset_to_policy_features(recorded.meta.features).keys() == {"observation.state", "action"}
    assert recorded.meta.features["commanded"]["names"] == recorded.meta.features["action"]["names"]
