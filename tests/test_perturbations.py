"""Perturbations against their definition, draw by draw where it is fixed and in the mean where it is not."""

import math

import pytest
import torch

from lerobot_gloves.perturbations import PERTURBATIONS, Laggy, Noised, Perturbation, Shift, Slow

ALL = [Noised(sigma=0.1), Laggy(p=0.5), Slow(alpha=0.5, p=0.5), Shift(dim=1, alpha=0.3, p=0.5)]
each = pytest.mark.parametrize("perturbation", ALL, ids=lambda one: type(one).__name__)


def chunks(batch: int, number: int = 1) -> list[torch.Tensor]:
    """Distinct chunks (batch, 10, 2), none of them zero anywhere."""
    generator = torch.Generator().manual_seed(0)
    return [torch.rand(batch, 10, 2, generator=generator) + 0.5 for _ in range(number)]


def emitted(perturbation: Perturbation, given: list[torch.Tensor], seed: int = 0, **reset: int) -> list[torch.Tensor]:
    perturbation.reset(given[0].shape[0], seed, **reset)
    return [perturbation(chunk) for chunk in given]


def within(count: int, trials: int, p: float) -> bool:
    """Whether a binomial count is within four standard deviations of what it should be."""
    return abs(count - trials * p) < 4 * math.sqrt(trials * p * (1 - p)) + 1e-9


def test_the_papers_parameters_are_the_defaults():
    assert list(PERTURBATIONS.items()) == [
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


@pytest.mark.parametrize("perturbation", [Laggy(p=0.0), Slow(p=0.0), Shift(p=0.0), Noised(sigma=0.0)])
def test_at_probability_zero_nothing_happens(perturbation):
    given = chunks(3, 5)
    assert torch.equal(torch.stack(emitted(perturbation, given)), torch.stack(given))


def test_at_probability_one_it_always_happens():
    given = chunks(3, 5)
    assert torch.equal(torch.stack(emitted(Laggy(p=1.0), given)), torch.stack([given[0]] * 5))
    assert torch.equal(torch.stack(emitted(Slow(p=1.0), given)), 0.5 * torch.stack(given))
    assert torch.equal(torch.stack(emitted(Shift(p=1.0, dim=0), given))[..., 1], torch.stack(given)[..., 1])


@each
def test_the_same_seed_perturbs_alike_and_another_one_otherwise(perturbation):
    given = chunks(4, 10)
    one, again, other = (torch.stack(emitted(perturbation, given, seed=seed)) for seed in (3, 3, 4))
    assert torch.equal(one, again)
    assert not torch.equal(one, other)


@each
def test_an_environment_is_perturbed_alike_in_any_batch(perturbation):
    given = chunks(4, 10)
    batch = emitted(perturbation, given, seed=5)
    for i in range(4):
        alone = emitted(perturbation, [chunk[i : i + 1] for chunk in given], seed=5, first_episode=i)
        assert torch.equal(torch.stack(alone), torch.stack(batch)[:, i : i + 1])


@each
def test_environments_are_perturbed_independently(perturbation):
    """The same chunks in every environment, and yet no two environments stay alike."""
    given = [chunk.expand(6, 10, 2) for chunk in chunks(1, 40)]
    out = torch.stack(emitted(perturbation, given)).transpose(0, 1).flatten(1)
    assert all(not torch.equal(out[i], out[j]) for i in range(6) for j in range(i))


@each
def test_the_chunk_given_is_left_alone(perturbation):
    given = chunks(4, 6)
    before = [chunk.clone() for chunk in given]
    emitted(perturbation, given)
    assert torch.equal(torch.stack(given), torch.stack(before))


@each
def test_a_batch_that_was_not_reset_for_is_refused(perturbation):
    perturbation.reset(2, seed=0)
    with pytest.raises(ValueError, match=f"{type(perturbation).__name__}.*2 environments.*4 chunks"):
        perturbation(chunks(4)[0])


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Noised(sigma=-0.1), r"sigma is -0\.1"),
        (lambda: Laggy(p=1.5), r"p is 1\.5"),
        (lambda: Slow(p=-0.5), r"p is -0\.5"),
        (lambda: Shift(p=2.0), r"p is 2\.0"),
    ],
)
def test_bad_parameters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_shifting_a_dimension_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match=r"dim is 2.*0 to 1"):
        emitted(Shift(dim=2), chunks(1))
    with pytest.raises(ValueError, match="dim is -1, but must not be negative"):
        Shift(dim=-1)


@pytest.mark.parametrize(("kind", "name"), [(Noised, "sigma"), (Slow, "alpha"), (Shift, "alpha")])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(kind, name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}, but must be finite"):
        kind(**{name: value})
