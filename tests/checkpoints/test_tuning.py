"""`gloves tune`'s figures against counts by hand, and against an adapter that knows what the expert does."""

import json
from dataclasses import dataclass, replace

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from torch.utils.data import DataLoader

from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.checkpoints.corrupted import Corrupted, Setting, corrupt_and_edit
from lerobot_gloves.checkpoints.held_out import HeldOutConfig
from lerobot_gloves.checkpoints.logged import p_values, read_log
from lerobot_gloves.checkpoints.on_data import open_adapter
from lerobot_gloves.checkpoints.tuning import best_first, outcomes
from lerobot_gloves.conformal import ConformalGate
from tests.builders import FLOW, save_policy, write_dataset

T = FLOW["chunk_size"]
FAULTS = ["noise", "offset", "replay"]


@dataclass(frozen=True)
class Towards:
    """Goes this share of the way to the expert's chunk, and this far on from there."""

    share: float = 0.5
    beyond: float = 0.0


@dataclass(frozen=True)
class Distance:
    power: float = 1.0


class Knowing:
    """An adapter that is told by the state which chunk is the expert's: `expert` maps it to (B, T, A)."""

    editors, scores = {"towards": Towards}, {"distance": Distance}

    def __init__(self, adapter, expert, history=0):
        self.config, self.expert, self.history = adapter.config, expert, history
        self.stride = T
        self.bound, self.told = 0, []

    def bind(self, observation, history=None):
        self.bound += 1
        self.told.append(history)
        bound = Bound()
        bound.expert, bound.adapter = self.expert(observation["observation.state"]), self
        return bound


class Bound:
    def score(self, chunk, score, length=None):
        return (chunk - self.expert).abs().sum(dim=(1, 2))

    def edit(self, proposal, editor, **given):
        assert len(given["generator"]) == len(proposal)
        return torch.lerp(proposal, self.expert, editor.share) + editor.beyond


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    root = write_dataset(tmp_path_factory.mktemp("data") / "tiny", episodes=3, length=4 * T).root
    config = PreTrainedConfig.from_pretrained(folder := save_policy(root.parent / "adapter", "gloves_expert_flow"))
    config.pretrained_path, config.device = folder, "cpu"
    return open_adapter(config, HeldOutConfig("me/tiny", root=str(root)), None)


def knowing(opened, history=0):
    """The data's actions are looked up by the state at which a chunk begins."""
    frames = opened.frames(opened.episodes, range(T))
    rows = opened.preprocess(next(iter(DataLoader(frames, batch_size=len(frames)))))
    states, chunks = rows["observation.state"], rows["action"]
    return replace(
        opened, adapter=Knowing(opened.adapter, lambda state: chunks[torch.cdist(state, states).argmin(1)], history)
    )


def test_what_remains_is_what_an_editor_leaves_by_its_own_formula(opened):
    told = knowing(opened)
    settings = [Setting(Towards(0.25)), Setting(Towards(1.0, beyond=0.5))]
    found = corrupt_and_edit(told, settings, {"distance": Distance()}, FAULTS, most=1000, batch_size=16)
    count = 3 * (4 * T - T + 1)
    assert found.kinds == ("healthy", *FAULTS) and found.proposed.shape == (count, 4)
    assert found.edited.shape == found.moved.shape == (2, count, 4)
    assert (found.proposed[:, 0] == 0).all() and (found.proposed[:, 1:3] > 0).float().mean() > 0.6
    torch.testing.assert_close(found.edited[0], 0.75 * found.proposed, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.moved[0], 0.25 * found.proposed, rtol=1e-4, atol=1e-4)
    far = torch.full((count, 4), 0.5 * 2**0.5, dtype=torch.float64)  # of two entries, both
    torch.testing.assert_close(found.edited[1], far, rtol=1e-4, atol=1e-4)
    healthy = found.scores["distance"][:, 0]
    assert healthy.max() < 1e-3 < found.scores["distance"][:, 1].median()
    assert told.adapter.bound <= 4 * 2, "once in each batch, not for each agent: 18 frames are told 0, 1, 2, 3 before"


def test_an_adapter_with_a_history_is_told_each_agents_own(opened):
    told = knowing(opened, history=2)
    found = corrupt_and_edit(told, [Setting(Towards())], {}, ["replay"], most=1000, batch_size=1000)
    histories = told.adapter.told
    assert len(histories) % 2 == 0 and histories[:2] == [None, None]
    later = [pair for pair in zip(histories[::2], histories[1::2], strict=True) if pair[0] is not None]
    assert {one.shape[1] for one, _ in later} == {1, 2}
    assert any(not torch.equal(healthy, replayed) for healthy, replayed in later)
    assert 0 < (found.proposed[:, 1] > 0).float().mean() < 0.8, "some chunks come again, others do not"


def test_no_fault_touches_what_never_changes(opened):
    adapter = knowing(opened)
    step = next(step for step in adapter.preprocess.steps if hasattr(step, "norm_map"))
    before = step.stats["action"]
    held = {name: torch.as_tensor(value).clone() for name, value in before.items()}
    for name in ("min", "max", "mean"):
        held[name][0] = 0.125
    held["std"][0] = 0.0
    try:
        step.stats["action"] = held
        step.to(device="cpu")  # makes its tensors anew
        found = corrupt_and_edit(adapter, [Setting(Towards())], {}, ["noise"], most=20, batch_size=64)
    finally:
        step.stats["action"] = before
        step.to(device="cpu")
    assert found.proposed.isfinite().all() and 0 < found.proposed[:, 1].mean() < 20


def corrupted(**more) -> Corrupted:
    """Two chunks, a fault that moves them by 1 and 3; one editor brings them to 0.5 and 1, and moves healthy by 0.4."""
    table = lambda *rows: torch.tensor(rows, dtype=torch.float64)  # noqa: E731
    return Corrupted(
        kinds=("healthy", "noise", "replay"),
        settings=[Setting(Towards(0.5))],
        proposed=table([0.0, 1.0, 0.0], [0.0, 3.0, 0.0]),
        edited=table([0.4, 0.5, 0.4], [0.4, 1.0, 0.4])[None],
        moved=table([0.4, 0.9, 0.4], [0.4, 2.5, 0.4])[None],
        scores={"distance": table([1.0, 2.0, 1.0], [7.0, 30.0, 1.0])},
        **more,
    )


def test_outcomes_are_those_counted_by_hand():
    """Of calibration scores 0 to 9, p-values of 1, 7, 2, 30 are 10, 4, 9 and 1 elevenths; shares left 1/2 and 1/3."""
    gates = {("distance", alpha): ConformalGate(torch.arange(10.0), alpha) for alpha in (0.2, 0.5)}
    alone, free, strict, loose = outcomes(corrupted(), Knowing.editors, gates, {})
    assert (alone.method, alone.change, alone.remains) == ("none", 0, {"noise": 1.0}), "nobody's chunk came again"
    assert free.method == "towards:share=0.5,beyond=0.0" and not free.gate and free.score is None
    assert (free.change, free.edit, free.remains["noise"]) == pytest.approx((0.4, 0.4, (1 / 2 + 1 / 3) / 2))
    assert (strict.gate, strict.score, strict.alpha) == (True, "distance", 0.2)
    assert (strict.change, strict.edit, strict.mean) == pytest.approx((0.0, 0.4, (1 + 1 / 3) / 2)), "only the 30 stops"
    assert (loose.change, loose.edit, loose.mean) == pytest.approx((0.2, 0.4, (1 + 1 / 3) / 2)), "the 7 as well"


def test_a_tiny_fault_made_large_counts_twice_and_no_fault_not_at_all():
    one = corrupted()
    tiny = replace(one, proposed=one.proposed * torch.tensor([1.0, 0.01, 1.0]), edited=one.edited + 0.1)
    _, free = outcomes(tiny, Knowing.editors, {}, {})
    assert free.remains == {"noise": 2.0}
    with pytest.raises(ValueError, match="none of the faults noise, replay changes"):
        outcomes(replace(one, proposed=0 * one.proposed), Knowing.editors, {}, {})


def test_an_agents_own_chunks_count_where_the_gate_stops_more_of_them():
    gates = {("distance", 0.2): ConformalGate(torch.arange(10.0), 0.2)}
    p_values = torch.tensor([0.1, 0.15, 0.2, 0.9])
    *_, gated = outcomes(corrupted(), Knowing.editors, gates, {"distance": p_values})
    assert gated.change == pytest.approx(0.75 * 0.4)


def test_the_best_is_the_gentlest_of_those_that_leave_least_and_healthy_chunks_alone():
    def outcome(name, change, edit, *remains):
        [one] = outcomes(corrupted(), Knowing.editors, {}, {})[1:]
        return replace(one, method=name, change=change, edit=edit, remains=dict(enumerate(remains)))

    found = [
        outcome("harms", 0.3, 0.3, 0.1, 0.1),
        outcome("strong", 0.1, 0.9, 0.3, 0.6),
        outcome("gentle", 0.0, 0.2, 0.2, 0.78),
        outcome("weak", 0.0, 0.1, 0.4, 0.7),
    ]
    assert [one.method for one in best_first(found, most_change=0.1)] == ["gentle", "strong", "weak", "harms"]
    assert best_first(found, most_change=0.3)[0].method == "harms"


def test_behind_the_gentlest_edit_stands_the_gate_that_turns_away_most():
    [one] = outcomes(corrupted(), Knowing.editors, {}, {})[1:]
    found = [
        replace(one, gate=True, score="distance", alpha=alpha, change=change, edit=0.2, remains={"a": mean})
        for alpha, change, mean in ((0.05, 0.02, 0.30), (0.2, 0.08, 0.31), (0.5, 0.2, 0.28), (0.1, 0.04, 0.30))
    ]
    open = replace(one, gate=False, alpha=None, change=0.2, edit=0.2, remains={"a": 0.28})
    weak = replace(one, gate=True, score="distance", alpha=0.2, change=0.08, edit=0.2, remains={"a": 0.9})
    another = replace(weak, score="another", alpha=0.5, remains={"a": 0.32})
    everything = [*found, open, another]
    assert best_first(everything, most_change=0.1)[0].alpha == 0.2
    assert best_first(everything, most_change=0.3)[0] is open
    assert best_first([found[0], weak, another], most_change=0.1)[0] is weak, "however little the level says itself"


def test_a_log_is_read_for_its_healthy_chunks(tmp_path):
    table = torch.arange(10.0).expand(2, -1)
    calibration = Calibration({"distance": table, "other": table}, "me/x", "v3.0", (0,), "weights")
    lines = [
        {"length": 2, "score": 7.0, "scores": {"distance": 7.0}},
        {"length": 2, "score": 1e999, "scores": {"distance": float("inf")}, "perturbed": False},
        {"length": 2, "score": 1.0, "scores": {"distance": 1.0}, "perturbed": True},
    ]
    log = tmp_path / "log.jsonl"
    log.write_text("\n".join(json.dumps(line).replace("Infinity", "1e999") for line in lines) + "\n")
    found = p_values(read_log(log), ["distance", "other"], calibration)
    assert list(found) == ["distance"] and found["distance"].tolist() == pytest.approx([4 / 11, 1 / 11])
    assert p_values(read_log(log), ["other"], calibration) == {}
    log.write_text('{"length": 2}\nstep 5\n')
    with pytest.raises(ValueError, match=r"line 2 of .* is none that --policy\.log writes"):
        read_log(log)
    log.write_text('{"length": 2}\n')
    with pytest.raises(ValueError, match=r"holds no scores: --policy\.score=reverse:steps=5 and --policy\.method=none"):
        read_log(log)
