"""What an IFAE step costs beyond the network evaluations that it needs, as a ratio measured in one run.

With one network for agent and expert flow, a step's evaluations are one batch: v_u at q, v_e at p, and, with guidance
other than 1, v_u at p too. The editor is compared with as many bare forward passes of that batch as it has steps, their
contexts laid out beforehand. Each pair runs in turn and the median of the pairwise ratios is printed, so that a
machine's mood cancels.

    python scripts/benchmark_ifae.py
"""

import argparse

import torch
from benchmark_editing import ACTION, CHUNK, STATE, make_network, ratio

from lerobot_gloves.editors import IFAE, Reference
from lerobot_gloves.flow import times
from lerobot_gloves.generators import spawn
from lerobot_gloves.networks import BoundVelocity
from lerobot_gloves.recording.sources import SOURCES


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=48, help="environments side by side")
    parser.add_argument("--steps", type=int, default=10, help="steps of IFAE")
    parser.add_argument("--repeats", type=int, default=30, help="pairs of calls")
    parser.add_argument("--width", type=int, default=128, help="hidden width of the network")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)

    network = make_network(labelled=True, width=arguments.width)
    state, label = torch.randn(arguments.batch, STATE), torch.eye(len(SOURCES))

    def flow(source: str) -> BoundVelocity:
        told = label[SOURCES.index(source)].expand(arguments.batch, -1)
        return network.bind({"state": state, "source": told})

    proposal, generators = torch.randn(arguments.batch, CHUNK, ACTION), spawn(0, arguments.batch)
    print(f"batch {arguments.batch}, width {arguments.width}, one thread, torch {torch.__version__}")
    for guidance in (1.0, 2.0):
        agent, expert = flow("noised"), flow("expert")
        editor = IFAE(steps=arguments.steps, guidance=guidance)
        reference = Reference(expert, agent, generator=generators)
        fields = [agent, expert, agent] if guidance != 1.0 else [agent, expert]
        stacked = agent.stack(fields[1:])
        points = torch.cat([proposal] * len(fields))
        editor(proposal, reference)
        evaluations = agent.evaluations + expert.evaluations

        @torch.no_grad()
        def bare(field: BoundVelocity | None = stacked, points: torch.Tensor = points) -> None:
            for k in range(arguments.steps):
                field(points, times(k / arguments.steps, points))

        value, ours, theirs = ratio(
            lambda editor=editor, reference=reference: editor(proposal, reference), bare, arguments.repeats
        )
        print(
            f"IFAE ({arguments.steps} steps, guidance {guidance:g}, {evaluations} evaluations an edit) / "
            f"{arguments.steps} batches of {len(fields)} evaluations: {value:.3f}x ({ours:.2f} ms / {theirs:.2f} ms)"
        )


if __name__ == "__main__":
    main()
