"""Consistency distillation (Song et al. 2023, algorithm 2): many steps of a teacher become one of a student."""

import torch
from torch import Tensor

from lerobot_gloves.flow import mean_per_chunk
from lerobot_gloves.generators import randn

from .edm import Denoiser, heun


def distillation_loss(
    student: Denoiser,
    target: Denoiser,
    teacher: Denoiser,
    action: Tensor,
    *,
    mask: Tensor | None = None,
    samples: int = 1,
    generator: torch.Generator | None = None,
) -> Tensor:
    """E ||f(x, sigma_i) - f_target(x', sigma_{i+1})||^2, mean per action, of every chunk.

    x is a chunk noised to level i of the grid, i uniform, and x' where one Heun step of the teacher takes it to the
    next, less noisy one. At the last step f_target is the identity, so what the student says there is what the teacher
    does; from there it hands on, level by level, what lies at the end of the teacher's whole path.

    Args:
        student: f, a consistency function bound to the B contexts of `action`.
        target: f_target, the same with other weights; no gradient flows into it.
        teacher: The denoiser that is distilled; no gradient flows into it either.
        action: Expert chunks, shape (B, T, A).
        mask: True where an action counts, shape (B, T); None: all count.
        samples: Independent draws of noise and of the level per chunk.
        generator: Source of the draws.

    Returns:
        Loss per chunk, shape (B,); 0 for a chunk that is all padding.
    """
    clean = action.repeat_interleave(samples, dim=0)
    grid = student.noise.grid(like=clean)
    device = clean.device if generator is None else generator.device
    level = torch.randint(len(grid) - 1, clean.shape[:1], generator=generator, device=device).to(clean.device)
    now, then = grid[level], grid[level + 1]
    noisy = clean + now[:, None, None] * randn(clean.shape, generator, like=clean)
    with torch.no_grad():
        aim = target(heun(teacher, noisy, now, then), then)
    return mean_per_chunk((student(noisy, now) - aim).square(), samples, mask)
