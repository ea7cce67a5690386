"""Move an agent's chunk towards the expert's, by each of the paper's three editors.

python examples/edit_a_chunk.py
"""

import torch

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.editors import FEEG, FPAS, IFAE, Reference
from lerobot_gloves.scores import ReverseScore
from score_a_chunk import MEAN, SPREAD, expert

BIAS = 1.0  # what is wrong with the agent


def agent(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
    """The agent's flow, which IFAE needs besides: the expert's, beside its mean by BIAS."""
    return expert(x - t[:, None, None] * BIAS, t) + BIAS


def main() -> None:
    """A hundred biased chunks: how far from the expert's mean they are before and after."""
    generator = torch.Generator().manual_seed(0)
    held_out, meant = (MEAN + SPREAD * torch.randn(100, 10, 2, generator=generator) for _ in range(2))
    proposal, score = meant + BIAS, ReverseScore(steps=5)
    threshold = ConformalGate(score(expert, held_out), alpha=0.05).threshold
    reference = Reference(expert, agent, score=score, threshold=threshold, generator=generator)
    print(f"proposal: {(proposal - MEAN).mean():+.2f}")
    for editor in (FPAS(), FEEG(start=0.5, align=0.1), IFAE()):
        chunk = editor(proposal, reference)
        moved = (chunk - proposal).norm(dim=-1).mean()
        print(f"{type(editor).__name__}: {(chunk - MEAN).mean():+.2f}, moved by {moved:.2f}")


if __name__ == "__main__":
    main()
