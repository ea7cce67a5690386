"""What holds of every perturbation: seeds, batches, resets, and what is refused."""

import math

import pytest
import torch

from lerobot_gloves.perturbations import (
    CHOICES,
    Chatter,
    Compound,
    Deadzone,
    Delayed,
    Dropped,
    Laggy,
    Noised,
    Quantised,
    Rotated,
    Shift,
    Slow,
    Smooth,
)
from tests.perturbations.chunks import chunks, emitted

DRAWING = [
    Noised(sigma=0.1),
    Laggy(p=0.5),
    Slow(alpha=0.5, p=0.5),
    Shift(dim=1, alpha=0.3, p=0.5),
    Smooth(sigma=0.1, tau=5.0),
    Dropped(p=0.3, hold=0.5),
    Chatter(p=0.1, steps=3),
    Compound("laggy:p=0.5+smooth:sigma=0.1+dropped+chatter"),
]
FIXED = [Delayed(steps=3), Deadzone(threshold=0.7), Quantised(step=0.1), Rotated(degrees=30.0)]


def name(perturbation):
    return type(perturbation).__name__


each = pytest.mark.parametrize("perturbation", [*DRAWING, *FIXED], ids=name)
each_that_draws = pytest.mark.parametrize("perturbation", DRAWING, ids=name)


def test_none_is_left_out():
    assert {type(one) for one in (*DRAWING, *FIXED)} == set(CHOICES.values())


@each
def test_the_same_seed_perturbs_alike(perturbation):
    given = chunks(4, 10)
    one, again = (torch.stack(emitted(perturbation, given, seed=3)) for _ in range(2))
    assert torch.equal(one, again)
    assert not torch.equal(one, torch.stack(given))


@each_that_draws
def test_another_seed_or_episode_perturbs_otherwise(perturbation):
    given = chunks(4, 10)
    one, other = (torch.stack(emitted(perturbation, given, seed=seed)) for seed in (3, 4))
    later = torch.stack(emitted(perturbation, given, seed=3, first_episode=4))
    assert not torch.equal(one, other) and not torch.equal(one, later)


@each
def test_an_environment_is_perturbed_alike_in_any_batch(perturbation):
    given = chunks(4, 10)
    batch = emitted(perturbation, given, seed=5)
    for i in range(4):
        alone = emitted(perturbation, [chunk[i : i + 1] for chunk in given], seed=5, first_episode=i)
        assert torch.equal(torch.stack(alone), torch.stack(batch)[:, i : i + 1])


@each_that_draws
def test_environments_are_perturbed_independently(perturbation):
    """The same chunks in every environment, and yet no two environments stay alike."""
    given = [chunk.expand(6, 10, 2) for chunk in chunks(1, 40)]
    out = torch.stack(emitted(perturbation, given)).transpose(0, 1).flatten(1)
    assert all(not torch.equal(out[i], out[j]) for i in range(6) for j in range(i))


@each
def test_the_chunk_given_is_left_alone(perturbation):
    given = chunks(4, 6)
    before = [chunk.clone() for chunk in given]
    out = emitted(perturbation, given)
    for one in out:
        one.fill_(7)
    assert torch.equal(torch.stack(given), torch.stack(before))


@pytest.mark.parametrize("perturbation", [*DRAWING[:-1], Delayed()], ids=name)
def test_a_batch_that_was_not_reset_for_is_refused(perturbation):
    perturbation.reset(2, seed=0)
    with pytest.raises(ValueError, match=f"{name(perturbation)}.*2 environments.*4 chunks"):
        perturbation(chunks(4)[0])
    with pytest.raises(ValueError, match=f"{name(perturbation)}.*0 environments.*4 chunks"):
        type(perturbation)()(chunks(4)[0])


@pytest.mark.parametrize(
    "perturbation",
    [
        Laggy(p=0.0),
        Slow(p=0.0),
        Shift(p=0.0),
        Noised(sigma=0.0),
        Smooth(sigma=0.0),
        Delayed(steps=0),
        Dropped(p=0.0),
        Deadzone(threshold=0.0),
        Rotated(degrees=0.0),
        Chatter(p=0.0),
    ],
    ids=name,
)
def test_at_strength_zero_nothing_happens(perturbation):
    given = chunks(3, 5)
    assert torch.equal(torch.stack(emitted(perturbation, given)), torch.stack(given))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Noised(sigma=-0.1), r"Noised: sigma is -0\.1, but must not be negative"),
        (lambda: Laggy(p=1.5), r"Laggy: p is 1\.5"),
        (lambda: Slow(p=-0.5), r"Slow: p is -0\.5"),
        (lambda: Shift(p=2.0), r"Shift: p is 2\.0"),
        (lambda: Shift(dim=-1), "Shift: dim is -1, but must not be negative"),
        (lambda: Smooth(sigma=-1.0), r"Smooth: sigma is -1\.0, but must not be negative"),
        (lambda: Smooth(tau=0.0), r"Smooth: tau is 0\.0, but must be positive"),
        (lambda: Delayed(steps=-1), "Delayed: steps is -1, but must not be negative"),
        (lambda: Dropped(p=1.5), r"Dropped: p is 1\.5, but must lie in \[0, 1\]"),
        (lambda: Dropped(hold=2.0), r"Dropped: hold is 2\.0, but must lie in \[0, 1\]"),
        (lambda: Deadzone(threshold=-0.1), r"Deadzone: threshold is -0\.1, but must not be negative"),
        (lambda: Quantised(step=0.0), r"Quantised: step is 0\.0, but must be positive"),
        (lambda: Rotated(first=-1), "Rotated: first is -1, but must not be negative"),
        (lambda: Rotated(first=2, second=2), "Rotated: first and second are both 2, but must be two dimensions"),
        (lambda: Chatter(dim=-2), "Chatter: dim is -2, but must not be negative, or -1 for the last"),
        (lambda: Chatter(p=-0.1), r"Chatter: p is -0\.1, but must lie in \[0, 1\]"),
        (lambda: Chatter(steps=0), "Chatter: steps is 0, but must be at least 1"),
    ],
)
def test_bad_parameters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        (Noised, "sigma"),
        (Slow, "alpha"),
        (Shift, "alpha"),
        (Smooth, "sigma"),
        (Smooth, "tau"),
        (Deadzone, "threshold"),
        (Quantised, "step"),
        (Rotated, "degrees"),
    ],
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(kind, field, value):
    with pytest.raises(ValueError, match=f"{kind.__name__}: {field} is {value}, but must be finite"):
        kind(**{field: value})


@pytest.mark.parametrize(
    ("perturbation", "message"),
    [
        (Shift(dim=2), "Shift: dim is 2, but actions have dimensions 0 to 1"),
        (Rotated(first=0, second=2), "Rotated: second is 2, but actions have dimensions 0 to 1"),
        (Rotated(first=3, second=1), "Rotated: first is 3, but actions have dimensions 0 to 1"),
        (Chatter(dim=2), "Chatter: dim is 2, but actions have dimensions 0 to 1"),
    ],
)
def test_a_dimension_that_does_not_exist_is_refused(perturbation, message):
    with pytest.raises(ValueError, match=message):
        emitted(perturbation, chunks(1))
