"""`gloves calibrate` where a score is told what was proposed before: the expert's own, or an agent's."""

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.scoring import Decisions
from lerobot_gloves.commands.calibrate import calibrate, main
from lerobot_gloves.generators import spawn
from lerobot_policy_gloves.gloves_copilot.modeling_gloves_copilot import GlovesCopilotPolicy
from tests.builders import FLOW, save_policy, wrap, write_dataset
from tests.policies.proposals import write_agent_dataset

T, STRIDE, H = FLOW["chunk_size"], FLOW["n_action_steps"], 2
EPISODES, LENGTH = 3, 20
BEGINS = LENGTH - T + 1


@pytest.fixture(scope="module")
def copilot(tmp_path_factory):
    return save_policy(tmp_path_factory.mktemp("saved") / "copilot", "gloves_copilot", seed=7)


@pytest.fixture(scope="module")
def corrector(copilot, tmp_path_factory):
    """The wrapper's own way to score, which knows of no dataset."""
    folder = tmp_path_factory.mktemp("wrapper")
    options = {"method": "none", "score": "correction", "log": folder / "log.jsonl"}
    return wrap(save_policy(folder / "agent", "act"), adapter=copilot, **options)._corrector


def run(typed, copilot, root, *options: str) -> Calibration:
    typed(
        f"--policy.path={copilot}", "--policy.device=cpu", "--dataset.repo_id=me/x", f"--dataset.root={root}", *options
    )
    return calibrate()


def as_the_wrapper(corrector, rows, frame, chunks):
    """Its score of the last of raw chunks (n, A), told of those before, under the observation of a row."""
    item = {key: rows[frame][key][None] for key in rows.features if key.startswith("observation.")}
    *before, proposal = [chunk[None] for chunk in chunks]
    return corrector(item, proposal, spawn(0, 1, stream="editor"), before).score[0]


def test_a_copilot_is_told_the_experts_last_decisions_from_the_episodes_first_on(typed, copilot, corrector, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=EPISODES, length=LENGTH).root
    calibration = run(typed, copilot, root, "--scores=[correction, reverse]", "--stride=1", "--batch_size=7")
    scores, of = calibration.scores["correction"], torch.tensor(calibration.episode_of)
    assert scores.shape == calibration.scores["reverse:steps=1"].shape == (T, EPISODES * BEGINS)
    assert of.bincount().tolist() == [BEGINS] * EPISODES
    rows = LeRobotDataset("me/x", root=root).hf_dataset
    for length in (T, 2):
        expected = []
        for frame in range(BEGINS):  # of the last episode
            decisions = [frame - back * STRIDE for back in (2, 1, 0) if frame >= back * STRIDE]
            first = (EPISODES - 1) * LENGTH
            chunks = [torch.stack([rows[first + d + i]["action"] for i in range(length)]) for d in decisions]
            expected.append(as_the_wrapper(corrector, rows, first + frame, chunks))
        # Sorted: chunks that are told equally many are scored together.
        found = scores[length - 1, of == EPISODES - 1].sort().values
        torch.testing.assert_close(found, torch.stack(expected).sort().values, rtol=1e-4, atol=1e-5)


def test_by_default_a_copilots_gate_is_calibrated_for_what_it_asks(typed, copilot, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=1, length=LENGTH).root
    calibration = run(typed, copilot, root, "--stride=6")
    assert {*calibration.scores} == {*(f"reverse:steps={steps}" for steps in (1, 2, 5, 10)), "correction"}


def test_chunks_begin_with_each_episode(typed, copilot, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=EPISODES, length=LENGTH).root
    calibration = run(typed, copilot, root, "--scores=[reverse]", "--stride=6")
    assert torch.tensor(calibration.episode_of).bincount().tolist() == [3] * EPISODES  # at 0, 6 and 12 of 20


def test_who_asks_for_no_history_is_told_none(typed, copilot, tmp_path, monkeypatch):
    root, told, bind = write_dataset(tmp_path / "data", episodes=1, length=LENGTH).root, [], GlovesCopilotPolicy.bind

    def spied(policy, observation, history=None):
        told.append(history)
        return bind(policy, observation, history)

    monkeypatch.setattr(GlovesCopilotPolicy, "bind", spied)
    run(typed, copilot, root, "--scores=[reverse]")
    assert told == [None, None], "bound once for all lengths, and once for a look at the adapter"
    assert Decisions(range(1, 7), every=5).indices == [0, 1, 2, 3, 4, 5]
    assert Decisions([2], every=5, stride=3, history=2).indices == list(range(-6, 2))


@pytest.fixture(scope="module")
def proposals():
    """Of 4 episodes, 5 queries each, 4 actions at a time."""
    return 0.004 * np.random.default_rng(0).normal(size=(4, 5, 4, 2)).astype(np.float32)


def test_an_agents_successes_are_scored_at_its_own_decisions(typed, copilot, corrector, proposals, tmp_path):
    root = write_agent_dataset(tmp_path / "data", proposals, "none", [True, False, True, False]).root
    calibration = run(typed, copilot, root, "--scores=[correction]", "--chunks_of=agent", "--batch_size=3")
    assert calibration.episodes == (0, 2)
    scores, of = calibration.scores["correction"], torch.tensor(calibration.episode_of)
    assert scores.shape == (4, 2 * 5) and of.bincount().tolist() == [5, 0, 5]
    rows = LeRobotDataset("me/x", root=root).hf_dataset
    raw = torch.from_numpy(proposals)
    for episode in (0, 2):
        expected = []
        for query in range(5):
            chunks = list(raw[episode, max(0, query - H) : query + 1])
            expected.append(as_the_wrapper(corrector, rows, 20 * episode + 4 * query, chunks))
        found = scores[3, of == episode].sort().values
        torch.testing.assert_close(found, torch.stack(expected).sort().values, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("source", "succeeded", "line"),
    [
        (
            "none",
            [False] * 4,
            "the 4 episodes of me/x hold no success of an agent as it is: record one by gloves record",
        ),
        ("noised", [True] * 4, "the 4 episodes of me/x hold no success of an agent as it is"),
    ],
)
def test_without_a_healthy_success_there_is_nothing_to_calibrate_on(
    typed, copilot, proposals, tmp_path, source, succeeded, line
):
    root = write_agent_dataset(tmp_path / "data", proposals, source, succeeded).root
    with pytest.raises(ValueError, match=line):
        run(typed, copilot, root, "--scores=[correction]", "--chunks_of=agent")


def test_longer_proposals_than_the_adapters_are_refused(typed, copilot, tmp_path):
    root = write_agent_dataset(tmp_path / "data", np.zeros((1, 2, T + 1, 2)), "none", [True]).root
    with pytest.raises(ValueError, match=f"the agent proposed {T + 1} actions at a time, but the adapter corrects {T}"):
        run(typed, copilot, root, "--scores=[correction]", "--chunks_of=agent")


def test_a_person_is_scored_by_commands_held_in_one_of_eight_directions(typed, copilot, tmp_path):
    root = write_dataset(tmp_path / "data", episodes=1, length=LENGTH).root
    calibration = run(typed, copilot, root, "--scores=[reverse]", "--stride=1", "--chunks_of=person")
    options = {"method": "none", "score": "reverse:steps=1", "log": tmp_path / "log.jsonl"}
    wrapped = wrap(save_policy(tmp_path / "agent", "act"), adapter=copilot, **options)._corrector
    rows = LeRobotDataset("me/x", root=root).hf_dataset
    actions = np.stack([rows[frame]["action"] for frame in range(LENGTH)])
    for frame, score in enumerate(calibration.scores["reverse:steps=1"][T - 1]):
        chunk = actions[frame : frame + T]
        candidates = []
        for ahead in range(1, T + 1):  # of the expert's way as far as a person looks ahead
            way = chunk[:ahead].sum(axis=0)
            eighth = np.round(np.arctan2(way[1], way[0]) / (np.pi / 4)) * (np.pi / 4)
            command = np.linalg.norm(chunk, axis=1).max() * np.array([np.cos(eighth), np.sin(eighth)])
            held = torch.from_numpy(np.tile(command, (T, 1)).astype(np.float32))
            candidates.append(float(as_the_wrapper(wrapped, rows, frame, [held])))
        assert np.abs(np.array(candidates) - float(score)).min() < 1e-4 * float(score)
        own = float(as_the_wrapper(wrapped, rows, frame, [torch.from_numpy(chunk)]))
        assert abs(own - float(score)) > 1e-3 * own


def test_whose_chunks_is_one_of_three(typed, copilot, tmp_path):
    typed(f"--policy.path={copilot}", "--dataset.repo_id=me/x", f"--dataset.root={tmp_path}", "--chunks_of=agents")
    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == "gloves calibrate: unknown chunks_of 'agents': choose from expert, agent, person"
