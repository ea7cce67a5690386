"""The paper's perturbations against their definition: draw by draw where it is fixed, in the mean where it is not."""

import math

import numpy as np
import pytest
import torch

from lerobot_gloves.perturbations import PERTURBATIONS, Laggy, Noised, Shift, Slow
from tests.perturbations.chunks import chunks, emitted, within


def test_the_papers_parameters_are_the_defaults():
    assert list(PERTURBATIONS.items())[:4] == [
        ("noised", Noised),
        ("laggy", Laggy),
        ("slow", Slow),
        ("shift", Shift),
    ]
    assert (Noised(), Laggy(), Slow(), Shift()) == (
        Noised(sigma=0.005),
        Laggy(p=0.2),
        Slow(alpha=0.5, p=0.5),
        Shift(dim=1, alpha=0.005, p=0.5),
    )


def test_noise_is_independent_with_the_standard_deviation_asked_for():
    given = [chunk.double() for chunk in chunks(500, 4)]
    noise = torch.stack(emitted(Noised(sigma=0.2), given)) - torch.stack(given)
    n = noise.numel()
    assert noise.mean().abs() < 4 * 0.2 / math.sqrt(n)
    assert noise.std().item() == pytest.approx(0.2, abs=4 * 0.2 / math.sqrt(2 * n))
    correlation = torch.corrcoef(noise.permute(0, 2, 3, 1).reshape(-1, 500)[:20])
    assert (correlation - torch.eye(20)).abs().max() < 4.5 / math.sqrt(500)


def test_noise_is_not_drawn_twice():
    first, second = emitted(Noised(sigma=0.1), [torch.zeros(3, 10, 2)] * 2)
    assert not torch.equal(first, second)


def test_laggy_repeats_the_chunk_last_emitted():
    """Not the one last proposed: after a repetition that would be a chunk nobody executed."""
    given = chunks(200, 30)
    out = emitted(Laggy(p=0.5), given)
    assert torch.equal(out[0], given[0])
    repeats, again_and_again = 0, 0
    last = torch.zeros(200, dtype=torch.bool)
    for k in range(1, 30):
        fresh = (out[k] == given[k]).all((1, 2))
        again = (out[k] == out[k - 1]).all((1, 2))
        assert (fresh ^ again).all()
        repeats += int(again.sum())
        again_and_again += int((again & last).sum())
        last = again
    assert within(repeats, 200 * 29, 0.5)
    # Repetitions of repetitions, which tell the two readings apart, did happen, and without memory.
    assert within(again_and_again, 200 * 28, 0.25)


def test_laggy_forgets_at_the_end_of_an_episode():
    perturbation = Laggy(p=1.0)
    before, after = chunks(2, 2)
    emitted(perturbation, [before])
    assert torch.equal(emitted(perturbation, [after])[0], after)


def test_laggy_is_not_fooled_by_a_caller_who_reuses_the_tensor():
    perturbation = Laggy(p=1.0)
    (chunk,) = chunks(2)
    expected = chunk.clone()
    (first,) = emitted(perturbation, [chunk])
    chunk.fill_(7)
    first.fill_(8)
    assert torch.equal(perturbation(chunk), expected)


def test_slow_scales_whole_chunks():
    given = chunks(200, 20)
    slowed = 0
    for chunk, out in zip(given, emitted(Slow(alpha=2.0, p=0.3), given), strict=True):
        changed = (out != chunk).any((1, 2))
        assert torch.equal(out, torch.where(changed[:, None, None], 2.0 * chunk, chunk))
        slowed += int(changed.sum())
    assert within(slowed, 200 * 20, 0.3)


def test_shift_offsets_one_dimension_of_whole_chunks():
    given = chunks(200, 20)
    offset = torch.tensor([0.25, 0.0])
    shifted = 0
    for chunk, out in zip(given, emitted(Shift(dim=0, alpha=0.25, p=0.3), given), strict=True):
        changed = (out != chunk).any((1, 2))
        assert torch.equal(out, torch.where(changed[:, None, None], chunk + offset, chunk))
        shifted += int(changed.sum())
    assert within(shifted, 200 * 20, 0.3)


def test_at_probability_one_it_always_happens():
    given = chunks(3, 5)
    assert torch.equal(torch.stack(emitted(Laggy(p=1.0), given)), torch.stack([given[0]] * 5))
    assert torch.equal(torch.stack(emitted(Slow(p=1.0), given)), 0.5 * torch.stack(given))
    assert torch.equal(torch.stack(emitted(Shift(p=1.0, dim=0), given))[..., 1], torch.stack(given)[..., 1])


def test_perturbations_combine_independently():
    """One after the other on the same seed: that a chunk was slowed says nothing of whether it is shifted."""
    slow, shift = Slow(alpha=0.5, p=0.5), Shift(dim=0, alpha=100.0, p=0.5)
    slow.reset(400, seed=0)
    shift.reset(400, seed=0)
    counts = torch.zeros(2, 2)
    for chunk in chunks(400, 10):
        out = shift(slow(chunk))
        slowed, shifted = out[:, 0, 1] != chunk[:, 0, 1], out[:, 0, 0] > 50
        expected = torch.where(slowed[:, None, None], 0.5 * chunk, chunk)
        expected[..., 0] += 100 * shifted[:, None]
        assert torch.equal(out, expected)
        for i in range(400):
            counts[int(slowed[i]), int(shifted[i])] += 1
    assert all(within(int(count), 4000, 0.25) for count in counts.flatten())


def generator(name: str, seed: int, episode: int) -> torch.Generator:
    """An environment's, written out: rows and trained checkpoints depend on what it draws."""
    (state,) = np.random.SeedSequence([seed, episode, *name.encode()]).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state) // 2)


def test_every_draw_is_the_one_it_has_always_been():
    """From version 0.1.0 on."""
    given = chunks(3, 20)
    noised = torch.stack(emitted(Noised(sigma=0.1), given, seed=5, first_episode=7))
    laggy = torch.stack(emitted(Laggy(p=0.4), given, seed=5, first_episode=7))
    slow = torch.stack(emitted(Slow(alpha=0.5, p=0.4), given, seed=5, first_episode=7))
    shift = torch.stack(emitted(Shift(dim=0, alpha=0.3, p=0.4), given, seed=5, first_episode=7))
    for row in range(3):
        drawn = {name: generator(name, 5, 7 + row) for name in ("Noised", "Laggy", "Slow", "Shift")}
        last = given[0][row]
        for step, chunk in enumerate(given):
            noise = torch.randn(1, 10, 2, generator=drawn["Noised"])
            lags, slows, shifts = (
                torch.rand((), generator=drawn[name]).item() < 0.4 for name in ("Laggy", "Slow", "Shift")
            )
            last = last if lags and step else chunk[row]
            assert torch.equal(noised[step, row], chunk[row] + 0.1 * noise[0])
            assert torch.equal(laggy[step, row], last)
            assert torch.equal(slow[step, row], 0.5 * chunk[row] if slows else chunk[row])
            assert torch.equal(shift[step, row], chunk[row] + torch.tensor([0.3, 0.0]) if shifts else chunk[row])
