"""Let a chunk pass if it could be the expert's: a gate that turns away at most a share alpha of the expert's own.

python examples/calibrate_and_gate.py
"""

import torch

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.scores import ReverseScore
from score_a_chunk import MEAN, SPREAD, expert


def main() -> None:
    """Calibrate on held-out chunks of the expert, then gate new ones, as they are and shifted."""
    generator = torch.Generator().manual_seed(0)
    held_out, new = (MEAN + SPREAD * torch.randn(1000, 10, 2, generator=generator) for _ in range(2))
    score = ReverseScore(steps=5)
    gate = ConformalGate(score(expert, held_out), alpha=0.05)
    print(f"threshold {gate.threshold:.1f}")
    for name, chunks in (("expert", new), ("shifted", new + 0.5)):
        scores = score(expert, chunks)
        passed = gate.admits(scores).double().mean().item()
        print(f"{name}: {100 * passed:.1f} % pass, median p-value {gate.p_value(scores).median().item():.3f}")


if __name__ == "__main__":
    main()
