"""Random draws of one environment do not depend on the batch it is in."""

import numpy as np
import pytest
import torch

from lerobot_gloves.generators import rand, randn, spawn
from tests.gaussian import seeded


def like(rows: int = 1) -> torch.Tensor:
    return torch.zeros(rows)


@pytest.mark.parametrize("draw", [rand, randn])
def test_a_row_drawn_in_a_batch_is_the_row_drawn_alone(draw):
    batch = draw((3, 4, 2), [seeded(i) for i in range(3)], like=like())
    for i in range(3):
        assert torch.equal(batch[i : i + 1], draw((1, 4, 2), [seeded(i)], like=like()))


def test_several_rows_of_one_environment_are_adjacent():
    batch = randn((6, 2), [seeded(0), seeded(1)], like=like())
    assert torch.equal(batch[:3], randn((3, 2), [seeded(0)], like=like()))
    assert torch.equal(batch[3:], randn((3, 2), [seeded(1)], like=like()))


def test_noise_has_the_dtype_asked_for():
    assert randn((2, 2), seeded(0), like=torch.zeros(1, dtype=torch.float64)).dtype == torch.float64
    assert randn((2, 2), [seeded(0)], like=torch.zeros(1, dtype=torch.float32)).dtype == torch.float32


@pytest.mark.parametrize("number", [0, 2, 4])
def test_generators_that_cannot_share_the_rows_are_refused(number):
    with pytest.raises(ValueError, match=f"3 rows.*{number} generators"):
        randn((3, 2), [seeded(i) for i in range(number)], like=like())


def states(*args: int, **kwargs: object) -> list[int]:
    return [generator.initial_seed() for generator in spawn(*args, **kwargs)]  # type: ignore[arg-type]


def test_a_generator_is_a_function_of_seed_episode_and_stream_alone():
    batch = states(7, 5)
    assert batch == states(7, 5)
    assert batch[2:] == states(7, 3, first_episode=2)
    assert len({*batch, *states(8, 5), *states(7, 5, stream="a"), *states(7, 5, stream="b")}) == 20


def test_streams_and_neighbouring_seeds_are_uncorrelated():
    """Neighbouring seeds of a raw generator may start alike; these must not."""
    first = np.array([rand((1,), one, like=like()).item() for one in spawn(0, 2000)])
    second = np.array([rand((1,), one, like=like()).item() for one in spawn(0, 2000, stream="other")])
    third = np.array([rand((1,), one, like=like()).item() for one in spawn(1, 2000)])
    correlations = np.corrcoef([first[:-1], first[1:], second[:-1], third[:-1]])
    assert np.abs(correlations - np.eye(4)).max() < 4 / np.sqrt(2000)
