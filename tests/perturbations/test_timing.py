"""Late and lost actions against shifts of the whole episode and a loop over its steps."""

import numpy as np
import pytest
import torch

from lerobot_gloves.perturbations import Delayed, Dropped, Laggy
from tests.perturbations.chunks import chunks, emitted, within


def episode(given: list[torch.Tensor]) -> np.ndarray:
    """The chunks one after the other."""
    return torch.cat(given, dim=1).numpy()


@pytest.mark.parametrize("steps", [0, 1, 4, 10, 13, 100])
def test_every_action_comes_so_many_steps_late(steps):
    """Longer than a chunk, and than the episode, too."""
    given = [*chunks(3, 2, length=10), *chunks(3, 3, length=4)]
    whole = episode(given)
    expected = whole[:, np.maximum(np.arange(whole.shape[1]) - steps, 0)]
    out = emitted(Delayed(steps=steps), given)
    assert [one.shape for one in out] == [one.shape for one in given]
    assert np.array_equal(episode(out), expected)


def test_what_was_due_is_forgotten_at_the_end_of_an_episode():
    perturbation = Delayed(steps=3)
    before, after = chunks(2, 2)
    emitted(perturbation, [before])
    (out,) = emitted(perturbation, [after])
    assert torch.equal(out[:, :4], after[:, :1].expand(-1, 4, -1))


def test_a_delay_is_not_fooled_by_a_caller_who_reuses_the_tensor():
    perturbation = Delayed(steps=10)
    (chunk,) = chunks(2)
    expected = chunk.clone()
    (first,) = emitted(perturbation, [chunk])
    chunk.fill_(7)
    first.fill_(8)
    assert torch.equal(perturbation(chunk), expected)


@pytest.mark.parametrize("hold", [0.0, 0.5, 1.0])
def test_what_takes_the_place_of_a_lost_action(hold):
    given = chunks(200, 5)
    whole, out = episode(given), episode(emitted(Dropped(p=0.3, hold=hold), given))
    assert np.array_equal(out[:, 0], whole[:, 0])
    lost = (out != whole).any(axis=2)
    last = whole[:, 0]
    for step in range(1, whole.shape[1]):
        last = np.where(lost[:, step, None], np.float32(hold) * last, whole[:, step])
        assert np.array_equal(out[:, step], last)
    assert within(int(lost.sum()), lost[:, 1:].size, 0.3)
    # Each by itself, over the borders of chunks as well.
    assert within(int((lost[:, 1:-1] & lost[:, 2:]).sum()), lost[:, 2:].size, 0.09)
    assert within(int(lost[:, 10::10].sum()), lost[:, 10::10].size, 0.3)


def test_an_action_of_the_last_episode_does_not_come_again():
    perturbation = Dropped(p=1.0)
    before, after = chunks(2, 2)
    emitted(perturbation, [before])
    (out,) = emitted(perturbation, [after])
    assert torch.equal(out, after[:, :1].expand_as(after))


@pytest.mark.parametrize("ran", [1, 3, 7])
def test_a_delay_goes_on_from_the_actions_that_ran(ran):
    """Of every chunk `ran` actions are executed; the rest was proposed in vain."""
    given = chunks(3, 8, length=10)
    perturbation = Delayed(steps=4)
    perturbation.reset(3, seed=0)
    out = [perturbation(chunk, ran if i else None)[:, :ran] for i, chunk in enumerate(given)]
    whole = episode([chunk[:, :ran] for chunk in given])
    expected = whole[:, np.maximum(np.arange(whole.shape[1]) - 4, 0)]
    assert np.array_equal(episode(out), expected)


def test_what_takes_the_place_of_a_lost_action_is_the_last_that_ran():
    perturbation, (first, second) = Dropped(p=0.0), chunks(2, 2)
    perturbation.reset(2, seed=0)
    perturbation(first)
    perturbation.p = 1.0
    assert torch.equal(perturbation(second, ran=3), first[:, 2:3].expand(-1, 10, -1))


def test_a_chunk_that_comes_again_fits_the_length_that_is_proposed_now():
    given = [*chunks(1, 1, length=3), *chunks(1, 1, length=5), *chunks(1, 1, length=2)]
    out = emitted(Laggy(p=1.0), given)
    assert [one.shape[1] for one in out] == [3, 5, 2]
    assert torch.equal(out[1], given[0][:, [0, 1, 2, 2, 2]]) and torch.equal(out[2], given[0][:, :2])
