"""An adapter in a package of its own, as docs/adapters.md has it: the wrapper takes it through the protocol alone."""

import importlib
import json
import re
import sys
from pathlib import Path

import pytest
import torch
from lerobot.policies import make_policy_config
from lerobot.scripts.lerobot_train import train

from lerobot_gloves.adapter import Adapter
from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.commands.calibrate import calibrate as calibrate_command
from tests.builders import calibrate, features, load, observation, save_policy, wrap, write_dataset
from tests.policies.test_training_command import LAST

PAGE = Path(__file__).parents[2] / "docs" / "adapters.md"
PACKAGE = "lerobot_policy_nudge"
T = 6
"""Chunk size of the example."""
NUDGE, DISTANCE = "nudge:share=0.25", "distance:power=2.0"


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The example's files, written where Python finds them."""
    folder = tmp_path_factory.mktemp("site") / PACKAGE
    folder.mkdir()
    files = re.findall(rf"`{PACKAGE}/(\S+\.py)`:\n\n```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert [name for name, _ in files] == ["configuration_nudge.py", "modeling_nudge.py", "processor_nudge.py"]
    for name, text in [*files, ("__init__.py", f"import {PACKAGE}.configuration_nudge\n")]:
        (folder / name).write_text(text)
    assert not any("gloves" in text for _, text in files)  # it needs nothing of ours
    sys.path.insert(0, str(folder.parent))
    yield importlib.import_module(f"{PACKAGE}.modeling_nudge")
    sys.path.remove(str(folder.parent))


def make(package):
    inputs, outputs = features()
    config = make_policy_config(
        "nudge", input_features=inputs, output_features=outputs, device="cpu", push_to_hub=False
    )
    torch.manual_seed(3)
    return package.NudgePolicy(config)


@pytest.fixture(scope="module")
def adapter(package, tmp_path_factory):
    folder = save_policy(tmp_path_factory.mktemp("adapter"), "nudge", policy=make(package))
    return calibrate(folder, scores={DISTANCE: torch.arange(1.0, 100.0).expand(T, -1).clone()}, chunk_size=T)


def expert_chunk(adapter: Path, batch: dict) -> torch.Tensor:
    """The example's raw prediction, by its linear map and its processors alone."""
    policy, (preprocess, postprocess) = load(adapter)
    state = preprocess({"observation.state": batch["observation.state"]})["observation.state"]
    with torch.no_grad():
        return postprocess(policy.linear(state).view(-1, T, 2))


def act(policy, batch, steps: int) -> torch.Tensor:
    with torch.inference_mode():
        return torch.stack([policy.select_action(batch) for _ in range(steps)], dim=1)


def test_it_answers_the_protocol(package):
    assert isinstance(make(package), Adapter)


def test_it_edits(checkpoints, adapter):
    batch, steps = observation(3), 5  # what the agent executes of a chunk
    policy = wrap(checkpoints.agent, adapter=adapter, method=NUDGE)
    edited = act(policy, batch, steps)
    proposed = act(wrap(checkpoints.agent), batch, steps)
    # Normalisation is affine, so a share of the way is that share in raw actions too.
    expected = proposed + 0.25 * (expert_chunk(adapter, batch)[:, :steps] - proposed)
    torch.testing.assert_close(edited, expected, rtol=1e-4, atol=1e-6)
    assert policy.statistics()["evaluations"] == 1


def test_one_that_asks_is_told_what_was_proposed_before(tmp_path, adapter, package, monkeypatch):
    heard, bind, length = [], package.NudgePolicy.bind, T
    agent = save_policy(tmp_path / "agent", "act", chunk_size=T, n_action_steps=T)

    def told(self, observation, history):
        heard.append(history)
        return bind(self, observation)

    monkeypatch.setattr(package.NudgePolicy, "history", 2, raising=False)
    monkeypatch.setattr(package.NudgePolicy, "bind", told)
    batch = observation(3)
    proposed = act(wrap(agent), batch, 4 * length).unflatten(1, (4, length))
    policy = wrap(agent, adapter=adapter, method=NUDGE)
    act(policy, batch, 3 * length)
    policy.running = torch.tensor([True, False, True])
    act(policy, batch, length)
    _, (preprocess, _) = load(adapter)
    normalised = preprocess({**observation(12), "action": proposed.flatten(0, 1)})["action"].unflatten(0, (3, 4))
    assert heard[0] is None, "nothing was proposed before"
    for decision, (rows, since) in enumerate([([0, 1, 2], 0), ([0, 1, 2], 0), ([0, 2], 1)], start=1):
        torch.testing.assert_close(heard[decision], normalised[rows, since:decision])
    policy.reset()
    act(policy, batch, 1)
    assert heard[4] is None, "another episode"


def test_its_own_editor_and_its_first_score_are_the_defaults(checkpoints, adapter, package, monkeypatch):
    monkeypatch.setattr(package.NudgePolicy, "editors", {"other": package.Distance, "nudge": package.Nudge})
    corrector = wrap(checkpoints.agent, adapter=adapter)._corrector
    assert (corrector.editor.share, corrector.gate.scores) == (0.5, (package.Distance(2.0),))


def test_it_is_gated(checkpoints, adapter, package, tmp_path):
    batch, log = observation(4), tmp_path / "log"
    proposed = act(wrap(checkpoints.agent), batch, 5)
    probe = wrap(checkpoints.agent, adapter=adapter, log=log, method="none")
    act(probe, batch, 1)
    scores = torch.tensor([json.loads(line)["score"] for line in log.read_text().splitlines()])
    assert len(scores.unique()) == 4
    # Calibrated so that, at level 0.5, the two lower scores pass.
    low, high = scores.sort().values[1:3].tolist()
    table = torch.full((T, 9), (low + high) / 2)
    folder = calibrate(
        save_policy(tmp_path / "gated", "nudge", policy=make(package)), scores={DISTANCE: table}, chunk_size=T
    )
    gated = wrap(checkpoints.agent, adapter=folder, method=NUDGE, gate=True, alpha=0.5)
    executed = act(gated, batch, 5)
    admitted = scores <= low
    assert admitted.sum() == 2
    assert torch.equal(executed[admitted], proposed[admitted])
    towards = proposed + 0.25 * (expert_chunk(folder, batch)[:, :5] - proposed)
    torch.testing.assert_close(executed[~admitted], towards[~admitted], rtol=1e-4, atol=1e-6)


def test_an_editor_that_needs_a_threshold_is_refused_without_a_calibration(
    checkpoints, adapter, package, monkeypatch, tmp_path
):
    bare = save_policy(tmp_path / "bare", "nudge", policy=make(package))
    wrap(checkpoints.agent, adapter=bare)
    monkeypatch.setattr(package.Nudge, "needs_threshold", True, raising=False)
    with pytest.raises(ValueError, match=f"nudge needs a calibration, and {bare} has none"):
        wrap(checkpoints.agent, adapter=bare)
    given = []

    def edit(self, proposal, editor, *, threshold, **_):
        given.append(threshold)
        return proposal

    monkeypatch.setattr(package.BoundNudge, "edit", edit)
    act(wrap(checkpoints.agent, adapter=adapter, alpha=0.5), observation(2), 5)
    assert given == [50.0]  # of the scores 1 to 99, 50 are not below it: its p-value, 51 / 100, is the last above alpha


def test_wrong_words_are_named_with_its_own(checkpoints, adapter):
    with pytest.raises(ValueError, match="unknown method 'feeg': choose from none, nudge"):
        wrap(checkpoints.agent, adapter=adapter, method="feeg")
    with pytest.raises(ValueError, match="unknown score 'reverse': choose from distance"):
        wrap(checkpoints.agent, adapter=adapter, score="reverse")


@pytest.fixture
def scoreless(adapter, package, monkeypatch):
    """The same without scores, and with a bound adapter that cannot be asked for one."""
    monkeypatch.setattr(package.NudgePolicy, "scores", {})
    monkeypatch.delattr(package.BoundNudge, "score")
    return adapter


def test_without_scores_it_edits_all_and_scores_none(checkpoints, scoreless, tmp_path):
    policy = wrap(checkpoints.agent, adapter=scoreless, log=tmp_path / "log")
    act(policy, observation(2), 5)
    (one, other) = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert one["edited"] and other["edited"] and one["score"] is None and one["p_value"] is None


@pytest.mark.parametrize("options", [{"gate": True}, {"score": "distance"}])
def test_without_scores_a_gate_is_refused(checkpoints, scoreless, options):
    with pytest.raises(ValueError, match=r"scores no proposals, so it has no gate: leave out --policy\.gate") as error:
        wrap(checkpoints.agent, adapter=scoreless, **options)
    assert "\n" not in str(error.value)


def test_without_editors_it_only_watches(checkpoints, adapter, package, monkeypatch):
    monkeypatch.setattr(package.NudgePolicy, "editors", {})
    monkeypatch.setattr(package.NudgePolicy, "default_editor", "none")
    batch = observation(2)
    watched = wrap(checkpoints.agent, adapter=adapter)
    assert torch.equal(act(watched, batch, 5), act(wrap(checkpoints.agent), batch, 5))
    assert watched.statistics()["intervention_rate"] == 0


@pytest.mark.slow
def test_lerobot_train_and_gloves_calibrate_take_it(package, checkpoints, tmp_path, typed):
    write_dataset(tmp_path / "data")
    data = ["--dataset.repo_id=me/tiny", f"--dataset.root={tmp_path / 'data'}"]
    typed(
        *data,
        "--policy.type=nudge",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        "--dataset.eval_split=0.25",
        "--batch_size=16",
        "--num_workers=0",
        "--steps=30",
        f"--output_dir={tmp_path / 'run'}",
    )
    train()
    folder = tmp_path / "run" / LAST / "pretrained_model"
    typed(*data, f"--policy.path={folder}", "--scores=[distance]", "--stride=1")
    calibrate_command()
    assert Calibration.load(folder).scores[DISTANCE].shape == (T, 12 - T + 1)
    # At 0.05 a gate with seven scores would let all pass, and is refused.
    assert wrap(checkpoints.agent, adapter=folder, gate=True, alpha=0.2).select_action(observation(2)).isfinite().all()
