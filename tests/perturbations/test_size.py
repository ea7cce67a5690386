"""Dead zone and quantisation against numpy."""

import numpy as np
import torch

from lerobot_gloves.perturbations import Deadzone, Quantised
from tests.perturbations.chunks import emitted


def spread() -> torch.Tensor:
    """Entries of both signs around zero."""
    return torch.randn(5, 10, 2, generator=torch.Generator().manual_seed(1))


def test_small_entries_become_zero_each_by_itself():
    (out,) = emitted(Deadzone(threshold=0.5), [spread()])
    numbers = spread().numpy()
    expected = np.where(np.abs(numbers) >= 0.5, numbers, 0)
    assert np.array_equal(out.numpy(), expected)
    kept = (expected != 0).sum(axis=2)
    assert {0, 1, 2} == set(kept.flatten())


def test_the_threshold_itself_stays():
    (out,) = emitted(Deadzone(threshold=0.5), [torch.tensor([[[0.5, -0.5, 0.49999]]])])
    assert out.tolist() == [[[0.5, -0.5, 0.0]]]


def test_entries_are_rounded_to_the_next_multiple():
    (out,) = emitted(Quantised(step=0.25), [spread()])
    numbers = spread().numpy()
    assert np.array_equal(out.numpy(), np.rint(numbers / 0.25) * 0.25)
    assert np.abs(out.numpy() - numbers).max() <= 0.125
    assert len(np.unique(out.numpy())) < 25


def test_a_step_that_is_no_power_of_two():
    (out,) = emitted(Quantised(step=0.3), [spread().double()])
    multiples = out.numpy() / 0.3
    np.testing.assert_allclose(multiples, np.rint(spread().double().numpy() / 0.3), atol=1e-12)
