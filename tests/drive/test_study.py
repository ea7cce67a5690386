"""A study, driven by a script: what is played, what the pages are told of it, and what is left in the folder."""

import json

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_gloves.drive.protocol import Begin
from lerobot_gloves.drive.study_folder import StudyFolder, Trial, draw_trials
from lerobot_gloves.drive.study_opening import open_study
from lerobot_gloves.drive.study_results import Driven as Done
from lerobot_gloves.drive.study_results import driven, study_table
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.recording.staging import StagedEpisode
from lerobot_gloves.tasks.slalom import SlalomEnv
from tests.builders import FLOW, save_policy
from tests.drive.test_session import VIEW, Driven

CONFIG = SlalomEnv(episode_length=5, image_size=64)
STICKS = [(1.0, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 1.0), (0.5, 0.5)]


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("adapter") / "flow", "gloves_expert_flow", **FLOW)


class Studied:
    """A study of four episodes, and a person who drives each to its end by the same five commands."""

    def __init__(self, env, flow, root, **changes):
        self.driven = Driven(env, adapter=flow, method="feeg:start=0.3")
        how = {
            "root": root,
            "episodes": 4,
            "seed": 100005,
            "options": {},
            "command": "gloves drive --study=4",
        } | changes
        self.study = open_study(CONFIG, self.driven.session, VIEW, self.driven.assistance, **how)
        self.snapshots = []

    def tick(self):
        self.snapshots.append(self.study.tick())
        self.driven.now += 0.05
        return self.snapshots[-1]

    def episode(self) -> list[np.ndarray]:
        """Drive one; what was executed in it."""
        before = len(self.driven.executed)
        for stick in STICKS:
            self.study.stick.move(*stick)
            self.tick()
        assert self.snapshots[-1].state["phase"] == "failure"
        return self.driven.executed[before:]

    def next(self):
        self.study.ask(Begin("next"))
        self.study.stick.release()
        return self.tick()


@pytest.fixture(scope="module")
def finished(flow, tmp_path_factory):
    """One that was stopped in its third episode and taken up again: its halves, and what every episode executed."""
    root, executed = tmp_path_factory.mktemp("study") / "mine", []
    with environments(CONFIG, 1) as env:
        first = Studied(env, flow, root)
        executed += [first.episode(), (first.next(), first.episode())[1]]
        first.next()
        first.study.stick.move(1.0, 0.0)
        assert first.tick().state["step"] == 1
    with environments(CONFIG, 1) as env:
        second = Studied(env, flow, root)
        executed += [second.episode(), (second.next(), second.episode())[1]]
        second.next()
    return root, (first, second), executed


def test_every_corridor_is_driven_both_ways_in_an_order_that_nobody_knows():
    orders = [draw_trials(20, 7, np.random.default_rng(seed)) for seed in range(40)]
    everything = {Trial(7 + i, assisted) for i in range(10) for assisted in (False, True)}
    assert all(len(order) == 20 and set(order) == everything for order in orders)
    first = [order[0].assisted for order in orders]
    assert len(set(map(tuple, orders))) == 40 and 8 < sum(first) < 32


def test_a_study_that_was_stopped_goes_on_with_the_episode_that_was_not_over(finished):
    root, (first, second), executed = finished
    trials = [Trial(**trial) for trial in json.loads((root / "plan.json").read_text())]
    assert {trial.seed for trial in trials} == {100005, 100006} and second.study._folder.trials == trials
    assert [s.about["study"]["episode"] for s in first.snapshots] == [1] * 5 + [2] * 6 + [3] * 2
    assert [s.about["study"]["episode"] for s in second.snapshots] == [3] * 5 + [4] * 7
    commands = [VIEW.steer(*stick) for stick in STICKS]
    for trial, actions in zip(trials, executed, strict=True):
        assert np.array_equal(actions, commands) != trial.assisted
    played = [first.snapshots[0].about["task"], first.snapshots[6].about["task"]]
    played += [second.snapshots[0].about["task"], second.snapshots[6].about["task"]]
    assert len({(trial.seed, task) for trial, task in zip(trials, played, strict=True)}) == 2


def test_the_pages_cannot_know_which_it_is(finished):
    for studied in finished[1]:
        for snapshot in studied.snapshots:
            told = {key: snapshot.state[key] for key in ("executed", "edited", "p")}
            assert told == {"executed": (0.0, 0.0, 0.0), "edited": False, "p": None}
            assert snapshot.about["settings"] is None and not any(edited for *_, edited in snapshot.trail)
            if snapshot.about["study"]["results"] is None:
                assert "assist" not in json.dumps([snapshot.about, snapshot.state])


def test_what_is_left_is_what_was_seen_commanded_and_executed(finished):
    root, (_, second), executed = finished
    recorded = LeRobotDataset("local/slalom_study", root=root / "dataset")
    columns = {key: np.stack(recorded.hf_dataset[key]) for key in recorded.features}
    assert (recorded.num_episodes, recorded.num_frames, recorded.fps) == (4, 20, 20)
    np.testing.assert_array_equal(columns["action"], np.concatenate(executed))
    np.testing.assert_array_equal(columns["commanded"], [VIEW.steer(*stick) for stick in STICKS] * 4)
    assisted = [trial["assisted"] for trial in json.loads((root / "plan.json").read_text())]
    np.testing.assert_array_equal(columns["assisted"].ravel(), np.repeat(assisted, 5))
    assert columns["edited"].ravel().tolist() == [a * float(any(s)) for a in assisted for s in STICKS]
    # The set-point that a step begins with is where the actions before it have moved it to.
    moved = np.diff(columns["observation.state"][:5, :2], axis=0)
    np.testing.assert_allclose(moved, columns["action"][:4], atol=1e-5)
    assert not {"commanded", "edited", "assisted"} & dataset_to_policy_features(recorded.meta.features).keys()
    card = (root / "dataset" / "README.md").read_text()
    assert (
        "# A person at the controls" in card
        and "Seeds 100005 to 100006, each driven twice" in card
        and "gloves drive --study=4" in card
    )
    assert "| without assistance | 0 of 2: 0 [0, 66] " in (root / "results.md").read_text()
    results = second.snapshots[-1].about["study"]["results"]
    assert results["lines"][1][0] == "with assistance" and results["picture"].startswith("data:image/svg+xml;base64,")
    assert (root / "paths.svg").read_text().count("<svg") == 1


def test_a_finished_study_shows_its_results_and_drives_nothing(finished, flow):
    root, (_, second), _ = finished
    with environments(CONFIG, 1) as env:
        again = Studied(env, flow, root)
        again.study.stick.move(1.0, 0.0)
        shown = again.tick()
        assert again.driven.executed == [] and shown.about["study"] == second.snapshots[-1].about["study"]


def test_nothing_can_be_set_and_no_episode_is_driven_twice(flow, tmp_path):
    with environments(CONFIG, 1) as env:
        studied = Studied(env, flow, tmp_path / "study")
        before = studied.driven.assistance.settings
        studied.study.ask(before)
        assert studied.tick().state["notice"] == "in a study nothing can be set"
        for message in (Begin("again"), Begin("next")):
            studied.study.ask(message)
            assert studied.tick().state["notice"] == "in a study every episode is driven once, to its end"
        assert studied.driven.assistance.settings == before and studied.tick().about["study"]["episode"] == 1


@pytest.mark.parametrize(
    ("changes", "told"),
    [({"seed": 1}, "holds episodes recorded with seed=100005"), ({"episodes": 6}, "recorded with episodes=4")],
)
def test_a_folder_of_another_study_is_refused(finished, flow, changes, told):
    with environments(CONFIG, 1) as env, pytest.raises(ValueError, match=told):
        Studied(env, flow, finished[0], **changes)


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ValueError, match="holds other files: choose another --output_dir"):
        StudyFolder(tmp_path, {}, 2, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_commands_are_changes_to_another_that_is_not_to_stand_still():
    commanded = np.float32([[1, 0], [1, 0], [0, 0], [1, 0], [0, 1], [0, 0]])
    facts = {"assisted": np.ones((6, 1)), "edited": np.float32([[1], [1], [0], [1], [0], [0]])}
    frames = {"action": commanded, "commanded": commanded, "at": np.arange(6.0), **facts}
    found = driven(
        3, StagedEpisode(frames, "task"), lambda frame: (float(frame["at"]), 0.0), lambda action: (*action, 0.0)
    )
    assert (found.commands, found.edited, found.success, found.path[-1]) == (3, 0.5, True, (5.0, 0.0))


def test_the_table_is_what_is_counted_by_hand():
    outcomes = {False: [True, False, False, True], True: [True, True, True, True]}
    steps = {False: [100, 300, 300, 120], True: [80, 90, 100, 112]}
    episodes = [
        Done(seed, assisted, outcomes[assisted][seed], steps[assisted][seed], 10 - 2 * assisted, 0.25 * assisted, [])
        for seed in (2, 0, 3, 1)
        for assisted in (True, False)
    ]
    lines = [[entry.in_one_line for entry in line] for line in study_table(episodes, 20).lines]
    # Wilson's interval of 2 of 4 is 50 ± 35, of 4 of 4 from 1 / (1 + 1.96^2 / 4) on; seconds (100 + 120) / 2 / 20,
    # (80 + 90 + 100 + 112) / 4 / 20, and where both succeeded (-20 - 8) / 2 / 20; p is 2 / 2^2 with two corridors that
    # differ alike, 2 / 2^4 with four.
    assert lines[0] == ["without assistance", "2 of 4: 50 [15, 85]", "5.5", "10.0", "0 %"]
    assert lines[1] == ["with assistance", "4 of 4: 100 [51, 100]", "4.8", "8.0", "25 %"]
    assert lines[2][1].startswith("+50 [") and lines[2][1].endswith("p = 0.500")
    assert lines[2][2:] == ["-0.7, p = 0.500", "-2.0, p = 0.125", "–"]
