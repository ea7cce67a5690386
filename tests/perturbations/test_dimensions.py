"""Rotation against numpy's matrix, the chatter of a sign against its rate and a loop over steps."""

import numpy as np
import pytest
import torch

from lerobot_gloves.perturbations import Chatter, Rotated
from tests.perturbations.chunks import emitted, within


def wide(batch: int, number: int = 1) -> list[torch.Tensor]:
    """Chunks (batch, 10, 4), positive."""
    generator = torch.Generator().manual_seed(2)
    return [torch.rand(batch, 10, 4, generator=generator, dtype=torch.float64) + 0.5 for _ in range(number)]


@pytest.mark.parametrize(("first", "second"), [(0, 1), (3, 1)])
@pytest.mark.parametrize("degrees", [-30.0, 0.0, 75.0, 200.0])
def test_two_dimensions_rotate_in_their_plane_all_the_time(first, second, degrees):
    given = wide(3, 4)
    angle = np.deg2rad(degrees)
    matrix = np.eye(4)
    matrix[np.ix_([first, second], [first, second])] = [
        [np.cos(angle), -np.sin(angle)],
        [np.sin(angle), np.cos(angle)],
    ]
    perturbation = Rotated(first=first, second=second, degrees=degrees)
    for chunk, out in zip(given, emitted(perturbation, given), strict=True):
        np.testing.assert_allclose(out.numpy(), chunk.numpy() @ matrix.T, rtol=1e-12, atol=1e-12)


def test_at_a_right_angle_the_first_becomes_the_second():
    (out,) = emitted(Rotated(degrees=90.0), [torch.tensor([[[1.0, 0.0], [0.0, 1.0]]])])
    torch.testing.assert_close(out, torch.tensor([[[0.0, 1.0], [-1.0, 0.0]]]))


def flips(perturbation: Chatter, batch: int, number: int) -> np.ndarray:
    """Where the sign of dimension 2 is flipped, (batch, steps); nothing else may change."""
    given = wide(batch, number)
    out = torch.cat(emitted(perturbation, given), dim=1)
    flipped = (out / torch.cat(given, dim=1)).numpy()
    assert set(np.unique(flipped)) <= {-1.0, 1.0}
    assert (np.delete(flipped, 2, axis=2) == 1).all()
    return flipped[..., 2] < 0


def test_a_flip_begins_with_its_probability_and_lasts_its_steps():
    """A step is flipped if a flip began at one of the last `steps`, inside its chunk or in one before."""
    flipped = flips(Chatter(dim=2, p=0.1, steps=4), batch=3000, number=4)
    for step in range(flipped.shape[1]):
        assert within(int(flipped[:, step].sum()), 3000, 1 - 0.9 ** min(step + 1, 4)), step
    # Whoever comes out of at least one unflipped step stays flipped for four, over the borders of chunks as well.
    began = flipped[:, 1:-3] & ~flipped[:, :-4]
    assert began[:, 7:10].any()
    for later in range(1, 4):
        assert flipped[:, 1 + later : flipped.shape[1] - 3 + later][began].all()


def test_single_steps_flip_independently():
    flipped = flips(Chatter(dim=2, p=0.3, steps=1), batch=500, number=4)
    assert within(int(flipped.sum()), flipped.size, 0.3)
    assert within(int((flipped[:, 1:] & flipped[:, :-1]).sum()), flipped[:, 1:].size, 0.09)


def test_a_flip_ends_with_the_episode():
    perturbation = Chatter(dim=2, p=0.5, steps=1000)
    assert flips(perturbation, batch=200, number=2)[:, -1].all()
    assert within(int(flips(perturbation, batch=200, number=1)[:, 0].sum()), 200, 0.5)


def test_the_last_dimension_is_the_default():
    (chunk,) = wide(2)
    (out,) = emitted(Chatter(p=1.0), [chunk])
    assert torch.equal(out, chunk * torch.tensor([1.0, 1.0, 1.0, -1.0]))


def test_a_flip_goes_on_from_the_actions_that_ran():
    """A flip of 6 steps that begins with the first action is over 3 steps after the third."""
    perturbation, (chunk,) = Chatter(dim=0, p=1.0, steps=6), [torch.ones(1, 10, 1)]
    perturbation.reset(1, seed=0)
    perturbation(chunk[:, :1])
    perturbation.p = 0.0
    assert perturbation(chunk).flatten().tolist() == [-1.0] * 5 + [1.0] * 5
    assert perturbation(chunk, ran=2).flatten().tolist() == [-1.0] * 3 + [1.0] * 7
