"""What editing and gating cost beyond the network evaluations that they need, as ratios measured in one run.

FEEG is compared with as many forward and backward passes of the bare network as it has steps; the one-step gate with
one forward pass. Each pair runs in turn and the median of the pairwise ratios is printed, so that a machine's mood
cancels.

    python scripts/benchmark_editing.py
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.editors import FEEG
from lerobot_gloves.flow import times
from lerobot_gloves.generators import spawn
from lerobot_gloves.networks import VelocityNetwork
from lerobot_gloves.scores import ReverseScore

CHUNK, ACTION, STATE = 10, 2, 16


def seconds(run: Callable[[], object]) -> float:
    """Wall time of one call."""
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def ratio(ours: Callable[[], object], bare: Callable[[], object], repeats: int) -> tuple[float, float, float]:
    """Median ratio of paired calls, and the medians in milliseconds."""
    ours(), bare()
    pairs = [(seconds(ours), seconds(bare)) for _ in range(repeats)]
    ratios = statistics.median(a / b for a, b in pairs)
    return ratios, *(1000 * statistics.median(column) for column in zip(*pairs, strict=True))  # type: ignore[return-value]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=48, help="environments side by side")
    parser.add_argument("--steps", type=int, default=10, help="steps of FEEG")
    parser.add_argument("--repeats", type=int, default=30, help="pairs of calls")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)

    # The output layers start at zero; random weights everywhere make the passes do real work.
    network = VelocityNetwork(ACTION, states={"state": STATE}).eval().requires_grad_(False)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.02)
    velocity = network.bind({"state": torch.randn(arguments.batch, STATE)})
    proposal = torch.randn(arguments.batch, CHUNK, ACTION)
    generators = spawn(0, arguments.batch)
    editor, score = FEEG(steps=arguments.steps), ReverseScore()
    gate = ConformalGate(torch.rand(5000))

    def passes() -> None:
        for k in range(arguments.steps):
            x = proposal.clone().requires_grad_()
            torch.autograd.grad(velocity(x, times(k / arguments.steps, x)), x, proposal)

    @torch.no_grad()
    def gated() -> None:
        gate.admits(score(velocity, proposal))

    @torch.no_grad()
    def forward() -> None:
        velocity(proposal, times(1.0, proposal))

    rows = {
        f"FEEG ({arguments.steps} steps) / its forward and backward passes": ratio(
            lambda: editor(proposal, velocity, generator=generators), passes, arguments.repeats
        ),
        "one-step gate / one forward pass": ratio(gated, forward, 10 * arguments.repeats),
    }
    print(f"batch {arguments.batch}, one thread, torch {torch.__version__}")
    for name, (value, ours, bare) in rows.items():
        print(f"{name}: {value:.3f}x ({ours:.2f} ms / {bare:.2f} ms)")


if __name__ == "__main__":
    main()
