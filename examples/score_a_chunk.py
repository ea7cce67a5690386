"""Score chunks of actions by how unlike the expert they are: all that it takes is a velocity field.

Here it is that of a Gaussian expert in closed form; a trained network is called the same way.

    python examples/score_a_chunk.py
"""

import torch

from lerobot_gloves.scores import ReverseScore

MEAN, SPREAD = 2.0, 0.5  # the expert's actions are Gaussian


def expert(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
    """v(x, t) of the flow from noise N(0, 1) at t = 0 to N(MEAN, SPREAD^2) at t = 1, on chunks (N, T, A)."""
    t = t[:, None, None]
    gain = (t * SPREAD**2 - (1 - t)) / ((1 - t) ** 2 + t**2 * SPREAD**2)
    return MEAN + gain * (x - t * MEAN)


def main() -> None:
    """An expert's chunk, the same shifted, and the same shaken, each of 10 actions of 2 numbers."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(3, 10, 2, generator=generator)
    chunk = MEAN + SPREAD * noise[:1]
    chunks = torch.cat([chunk, chunk + 1.0, chunk + noise[1:2]])
    for steps in (1, 5):
        scores = ReverseScore(steps=steps)(expert, chunks)
        named = zip(("expert", "shifted", "shaken"), scores.tolist(), strict=True)
        print(f"{steps} reverse steps:", ", ".join(f"{name} {score:.1f}" for name, score in named))
    # A flow without error carries every chunk back to itself in one step: that score lives off a network's errors.


if __name__ == "__main__":
    main()
