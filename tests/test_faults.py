"""Randomised agents against what their faults say of themselves, derived by other means."""

import math

import numpy as np
import pytest
import torch

from lerobot_gloves import faults
from lerobot_gloves.faults import FAULTS, RandomisedAgents, Units
from tests.gaussian import seeded

AGENTS, DECISIONS, T, A = 500, 4, 6, 3
ZERO = torch.tensor([0.5, -1.0, 0.0])
UNITS = Units(ZERO, torch.tensor([0.1, 0.2, 3.0]))


@pytest.fixture
def history() -> torch.Tensor:
    return torch.randn(AGENTS, DECISIONS, T, A, generator=seeded(0))


def made(fault, history, seed=1):
    return fault(history, UNITS, seeded(seed))


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_changes_chunks_not_their_shape_and_never_its_input(name, history):
    before = history.clone()
    faulty = made(FAULTS[name](), history)
    assert faulty.shape == history.shape and faulty.isfinite().all() and torch.equal(history, before)
    assert (faulty != history).flatten(1).any(dim=1).float().mean() > 0.5
    assert torch.equal(faulty, made(FAULTS[name](), history)), "the same seed, the same agents"
    assert not torch.equal(faulty, made(FAULTS[name](), history, seed=2))


def test_noise_has_the_spread_that_is_drawn(history):
    moved = made(faults.Noise(sigma=(0.5, 0.5 + 1e-9)), history) - history
    spread = moved.flatten(1, 2).std(dim=1)
    robots = spread[:, 2] < 0.2
    assert robots.float().mean().item() == pytest.approx(0.5, abs=0.06)
    assert moved[~robots].std().item() == pytest.approx(0.5, rel=0.02)
    raw = (moved[robots] * UNITS.spread).std(dim=(0, 1, 2))
    assert raw.numpy() == pytest.approx(0.5 * 0.2, rel=0.03), "equal in the robot's units, as on the middling entry"


def test_drift_is_smooth_within_and_across_chunks():
    quiet = torch.zeros(4000, 3, 5, 2)
    moved = faults.Drift(sigma=(2.0, 2.0 + 1e-9), time=(8.0, 8.0 + 1e-9))(
        quiet, Units(torch.zeros(2), torch.ones(2)), seeded(1)
    ).flatten(1, 2)
    assert moved.std(dim=0).numpy() == pytest.approx(2.0, rel=0.08)
    for lag in (1, 5, 7):
        both = np.corrcoef(moved[:, 0, 0].numpy(), moved[:, lag, 0].numpy())[0, 1]
        assert both == pytest.approx(math.exp(-lag / 8), abs=0.05)


def test_a_replayed_chunk_is_the_last_that_was_emitted(history):
    faulty = made(faults.Replay(p=(0.5, 0.5)), history)
    assert torch.equal(faulty[:, 0], history[:, 0])
    repeats = (faulty[:, 1:] == faulty[:, :-1]).flatten(2).all(dim=2)
    assert torch.equal(faulty[:, 1:][~repeats], history[:, 1:][~repeats])
    assert repeats.float().mean().item() == pytest.approx(0.5, abs=0.05)


def test_a_delay_shifts_the_actions_of_all_decisions(history):
    faulty = made(faults.Delay(steps=(0.5, 0.5)), history).flatten(1, 2)
    actions = history.flatten(1, 2)
    assert torch.equal(faulty[:, 3:], actions[:, :-3])
    assert torch.equal(faulty[:, :3], actions[:, :1].expand(-1, 3, -1))


def test_scaling_is_about_standing_still(history):
    faulty = made(faults.Scale(factor=(0.25, 0.25 + 1e-9), p=(1.0, 1.0)), history)
    torch.testing.assert_close(faulty - ZERO, 0.25 * (history - ZERO))


def test_an_offset_is_on_one_entry_of_whole_chunks(history):
    moved = made(faults.Offset(size=(0.7, 0.7 + 1e-9), p=(0.5, 0.5)), history) - history
    whole = moved.mean(dim=2)
    torch.testing.assert_close(moved, whole[:, :, None].expand_as(moved), atol=1e-5, rtol=0)
    sizes = whole.abs().sum(dim=2)
    assert ((sizes - 0.7).abs() < 1e-4).logical_or(sizes < 1e-4).all()
    assert (sizes > 0.1).float().mean().item() == pytest.approx(0.5, abs=0.05)
    assert (whole.abs().sum(dim=1) > 1e-4).sum(dim=1).max() == 1, "the same entry at every decision"


def test_small_commands_are_lost_in_a_dead_zone(history):
    faulty = made(faults.DeadZone(threshold=(0.8, 0.8 + 1e-9)), history)
    small = (history - ZERO).abs() < 0.8
    assert torch.equal(faulty[small], ZERO.expand_as(history)[small]) and torch.equal(faulty[~small], history[~small])


def test_entries_are_rounded_as_numpy_rounds_them(history):
    faulty = made(faults.Quantised(step=(0.5, 0.5 + 1e-9)), history)
    expected = ZERO.numpy() + 0.5 * np.round((history - ZERO).numpy() / 0.5)
    np.testing.assert_allclose(faulty.numpy(), expected, atol=1e-6)


def test_lost_actions_stand_still(history):
    faulty = made(faults.Dropped(p=(0.3, 0.3)), history)
    lost = (faulty == ZERO).all(dim=-1)
    assert torch.equal(faulty[~lost], history[~lost]) and lost.float().mean().item() == pytest.approx(0.3, abs=0.02)


def test_a_turned_frame_keeps_lengths_and_turns_by_the_angle():
    history = torch.randn(AGENTS, DECISIONS, T, 2, generator=seeded(0))
    units = Units(torch.tensor([0.5, -1.0]), torch.tensor([0.1, 0.2]))
    faulty = faults.Rotated(angle=(30.0, 30.0))(history, units, seeded(1))
    before, after = (torch.view_as_complex((chunk - units.zero) * units.spread) for chunk in (history, faulty))
    turned = torch.rad2deg((after / before).angle())
    torch.testing.assert_close(after.abs(), before.abs())
    torch.testing.assert_close(turned.abs(), torch.full_like(turned, 30.0), atol=1e-2, rtol=0)
    assert (turned[:, :1, :1] * turned > 0).all(), "one frame an agent"


def test_entries_of_like_spread_are_turned_into_one_another(history):
    faulty = made(faults.Rotated(), history)
    moved = ((faulty - history).abs() > 1e-5).flatten(1, 2).any(dim=1)
    pairs = {tuple(row.nonzero()[:, 0].tolist()) for row in moved}
    assert pairs == {(0, 1), (1, 2)}


def test_a_chattering_entry_is_mirrored_about_standing_still(history):
    faulty = made(faults.Chatter(p=(0.2, 0.2)), history)
    turned = faulty != history
    torch.testing.assert_close(faulty[turned], (2 * ZERO - history)[turned])
    assert turned.sum(dim=3).max() == 1
    assert turned.any(dim=3).float().mean().item() == pytest.approx(0.2, abs=0.02)


def test_a_persons_command_is_held_and_one_of_eight_directions(history):
    faulty = made(faults.Held(), history)
    assert torch.equal(faulty, faulty[:, :, :1].expand_as(faulty))
    command = (faulty - ZERO)[:, :, 0]
    largest = command.abs().topk(2, dim=-1).values
    ratio = largest[..., 1] / largest[..., 0]
    assert ((ratio < 1e-4) | ((ratio - 1).abs() < 1e-4)).all()
    assert (command.abs() > 1e-5).sum(dim=-1).max() == 2


SURE = {"ahead": (1.0, 1.0), "held": (1.0, 1.0), "speed": (1.0, 1.0), "slips": (0.0, 0.0), "waits": (0.0, 0.0)}


def driven_timeline(late: float, **options):
    """What a driver makes of a robot that is steered to any side at full speed, and of its gripper; both raw."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(-np.pi, np.pi, (50, 15))
    raw = np.stack([0.01 * np.cos(angle), 0.01 * np.sin(angle), np.sign(rng.uniform(-1, 1, (50, 15)))], axis=-1)
    spread = np.array([0.005, 0.007, 1.0])
    units = Units(ZERO.double(), torch.from_numpy(spread))
    history = units.normalised(torch.from_numpy(np.stack([raw[:, k : k + 5] for k in range(11)], axis=1)))
    made = faults.Driven(**{"late": (late, late), **SURE, **options})(history, units, seeded(3))
    return raw, units.raw(made).numpy()


@pytest.mark.parametrize("late", [0, 4])
def test_a_driver_presses_one_of_eight_directions_late(late):
    raw, made = driven_timeline(late)
    np.testing.assert_allclose(made, np.repeat(made[:, :, :1], 5, axis=2), atol=1e-12)  # held for a chunk
    seen = raw[:, np.maximum(np.arange(11) - late, 0)]
    eighth = np.round(np.arctan2(seen[..., 1], seen[..., 0]) / (np.pi / 4)) * (np.pi / 4)
    expected = 0.01 * np.stack([np.cos(eighth), np.sin(eighth)], axis=-1)
    np.testing.assert_allclose(made[:, :, 0, :2], expected, atol=1e-9)
    np.testing.assert_allclose(made[:, :, 0, 2], seen[..., 2], atol=1e-9)  # nothing but late


def test_a_driver_slips_to_neighbouring_keys_and_waits_but_never_now():
    _, sure = driven_timeline(2)
    _, slipped = driven_timeline(2, slips=(1.0, 1.0))
    angle = [np.arctan2(made[:, :, 0, 1], made[:, :, 0, 0]) for made in (sure, slipped)]
    moved = np.linalg.norm(slipped[:, :, 0, :2], axis=-1) > 1e-9
    turned = np.abs((angle[1] - angle[0] + np.pi) % (2 * np.pi) - np.pi)[moved] / (np.pi / 4)
    assert (
        set(turned.round(6)) == {0.0, 1.0} and 0.4 < turned.mean() < 0.9
    )  # a third falls on the gripper, which has none
    _, waited = driven_timeline(2, waits=(1.0, 1.0))
    assert not waited[:, :-1, :, :2].round(9).any() and np.linalg.norm(waited[:, -1, 0, :2], axis=-1).min() > 0.009


def test_shares_of_healthy_agents_and_of_those_with_two_faults(history):
    agents = RandomisedAgents(healthy=0.3, several=0.5)
    has = agents.draw(20000, history, seeded(1))
    number = has.sum(dim=1)
    shares = [(number == n).float().mean().item() for n in range(3)]
    assert shares == pytest.approx([0.3, 0.35, 0.35], abs=0.01) and number.max() == 2
    assert has.float().mean(dim=0).numpy() == pytest.approx(has.float().mean().item(), abs=0.01)


def test_only_the_named_faults_happen(history):
    agents = RandomisedAgents(faults=("replay", "scale"), healthy=0.0, several=0.0)
    faulty = agents(history, UNITS, seeded(1))
    line = (history - ZERO).flatten(2)
    moved = (faulty - ZERO).flatten(2)
    scaled = torch.nn.functional.cosine_similarity(line, moved, dim=2) > 1 - 1e-5
    replayed = torch.stack([(faulty[:, :, None] == history[:, None]).flatten(3).all(dim=3)]).any(dim=3)[0]
    assert (scaled | replayed).all() and scaled.any() and (replayed & ~scaled).any()


def test_a_healthy_agent_is_the_expert(history):
    assert torch.equal(RandomisedAgents(healthy=1.0)(history, UNITS, seeded(1)), history)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"faults": ("noisy",)}, "there is no fault 'noisy': choose from held, driven, rotated"),
        ({"faults": ()}, "no fault is named"),
        ({"healthy": 1.5}, "healthy is 1.5, but must lie in"),
        ({"several": -0.1}, "several is -0.1, but must lie in"),
    ],
)
def test_what_makes_no_sense_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        RandomisedAgents(**options)
