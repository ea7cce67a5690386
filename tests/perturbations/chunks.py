"""Chunks to perturb, and what comes out."""

import math

import torch

from lerobot_gloves.perturbations import Perturbation


def chunks(batch: int, number: int = 1, length: int = 10) -> list[torch.Tensor]:
    """Distinct chunks (batch, length, 2), none of them zero anywhere."""
    generator = torch.Generator().manual_seed(0)
    return [torch.rand(batch, length, 2, generator=generator) + 0.5 for _ in range(number)]


def emitted(perturbation: Perturbation, given: list[torch.Tensor], seed: int = 0, **reset: int) -> list[torch.Tensor]:
    perturbation.reset(given[0].shape[0], seed, **reset)
    return [perturbation(chunk) for chunk in given]


def within(count: int, trials: int, p: float) -> bool:
    """Whether a binomial count is within four standard deviations of what it should be."""
    return abs(count - trials * p) < 4 * math.sqrt(trials * p * (1 - p)) + 1e-9
