"""Compounds are their parts, one after the other, and are read back as they are written."""

import copy

import numpy as np
import pytest
import torch

from lerobot_gloves.perturbations import (
    PERTURBATIONS,
    Compound,
    Laggy,
    Noised,
    Perturbation,
    Shift,
    parse_perturbation,
    written_out,
)
from tests.perturbations.chunks import chunks, emitted


def alone(parts: list[Perturbation], given: list[torch.Tensor], seed: int) -> list[torch.Tensor]:
    """What comes out of the parts, each reset by itself, from left to right."""
    for part in parts:
        given = emitted(part, given, seed=seed)
    return given


@pytest.mark.parametrize("text", ["noised:sigma=0.1+laggy:p=0.5", "laggy:p=0.5+noised:sigma=0.1"])
def test_it_is_its_parts_one_after_the_other(text):
    given = chunks(4, 12)
    parts = [parse_perturbation(part) for part in text.split("+")]
    out = torch.stack(emitted(Compound(text), given, seed=3))
    assert torch.equal(out, torch.stack(alone(parts, given, seed=3)))
    assert not torch.equal(out, torch.stack(alone(parts[::-1], given, seed=3)))


def test_all_of_them_at_once_draw_as_each_would_alone():
    given = chunks(3, 12)
    parts = [choice() for choice in PERTURBATIONS.values()]
    out = emitted(Compound("+".join(PERTURBATIONS)), given, seed=7)
    assert torch.equal(torch.stack(out), torch.stack(alone(parts, given, seed=7)))


def test_two_of_a_kind_do_not_share_draws():
    """Twice the same noise would be noise of twice the size: of two streams it is the root of two times as large."""
    given = [torch.zeros(2000, 10, 2)]
    one, two, three = (emitted(Compound("+".join(["noised:sigma=1"] * n)), given)[0] for n in (1, 2, 3))
    second, third = two - one, three - two
    found = torch.corrcoef(torch.stack([one.flatten(), second.flatten(), third.flatten()]))
    assert (found - torch.eye(3)).abs().max() < 4 / np.sqrt(40000)
    assert torch.equal(one, emitted(Noised(sigma=1.0), given)[0])


def test_two_shifts_are_of_two_dimensions():
    given = chunks(200, 5)
    out = torch.stack(emitted(Compound("shift:dim=0,alpha=8,p=0.5+shift:dim=1,alpha=8,p=0.5"), given))
    shifted = (out > 5).all(dim=2).flatten(0, 1)
    counts = torch.bincount(2 * shifted[:, 0].long() + shifted[:, 1].long(), minlength=4)
    assert (counts - 250).abs().max() < 4 * np.sqrt(1000 * 0.25 * 0.75)


def test_copies_do_not_share_what_an_episode_leaves():
    """The wrapper plays a copy of its configuration's."""
    told = Compound("delayed:steps=5+dropped:p=0.3")
    one, other = copy.deepcopy(told), copy.deepcopy(told)
    given = chunks(2, 6)
    one.reset(2, seed=0)
    other.reset(2, seed=0)
    out = [(one(chunk), other(chunk)) for chunk in given]
    assert all(torch.equal(*pair) for pair in out)
    assert torch.equal(torch.stack([pair[0] for pair in out]), torch.stack(emitted(told, given)))


@pytest.mark.parametrize(
    ("text", "expected", "written"),
    [
        ("none", None, "none"),
        ("noised", Noised(), "noised:sigma=0.005"),
        ("shift:dim=0", Shift(dim=0), "shift:dim=0,alpha=0.005,p=0.5"),
        ("noised+laggy", Compound("noised+laggy"), "noised:sigma=0.005+laggy:p=0.2"),
        ("noised:sigma=1e+3+laggy", Compound("noised:sigma=1e+3+laggy"), "noised:sigma=1000.0+laggy:p=0.2"),
        ("noised:sigma=1e22", Noised(sigma=1e22), "noised:sigma=1e+22"),
    ],
)
def test_what_is_written_is_read_back(text, expected, written):
    found = parse_perturbation(text)
    assert type(found) is type(expected) and found == expected
    assert written_out(found) == written
    assert written_out(parse_perturbation(written)) == written


def test_the_parts_have_their_options():
    laggy, noised = Compound("laggy:p=0.9+noised")._parts
    assert (laggy, noised) == (Laggy(p=0.9), Noised())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noised+lagy", "unknown perturbation 'lagy': choose from chatter, deadzone, .*, smooth"),
        ("noised+none", "unknown perturbation 'none': choose from chatter, "),
        ("noised+", "unknown perturbation ''"),
        ("noised+laggy:q=1", "perturbation 'laggy' has no option 'q': choose from p"),
        ("noised+laggy:p=2", r"Laggy: p is 2\.0, but must lie in \[0, 1\]"),
        ("noised:sigma=0.1+0.2", r"perturbation 'noised': sigma='0\.1\+0\.2' is not a number of type float"),
        ("compound:parts=noised", "unknown perturbation 'compound': choose from"),
        ("nosied", "unknown perturbation 'nosied': choose from chatter, .*, none, "),
    ],
)
def test_a_wrong_word_is_named(text, message):
    with pytest.raises(ValueError, match=message):
        parse_perturbation(text)
