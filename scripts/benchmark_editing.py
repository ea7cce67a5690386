"""What editing and gating cost, all methods side by side and as ratios measured in one run.

First what they cost beyond the network evaluations that they need: FEEG is compared with as many forward and backward
passes of the bare network as it has steps; the one-step gate with one forward pass. Then every method's evaluations and
milliseconds, all with networks of the demo's size and random weights, each relative to one forward pass of its network.
Each pair runs in turn and the median of the pairwise ratios is printed, so that a machine's mood cancels. Looking at
the observation, once a chunk and alike for all, is left out.

    python scripts/benchmark_editing.py
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from lerobot_gloves.conformal import ConformalGate
from lerobot_gloves.editors import FEEG, FPAS, IFAE, Copilot, Reference
from lerobot_gloves.flow import times
from lerobot_gloves.generators import spawn
from lerobot_gloves.networks import BoundVelocity, VelocityNetwork
from lerobot_gloves.networks.copilot import CopilotNetwork, told
from lerobot_gloves.recording.sources import SOURCES
from lerobot_gloves.scores import ReverseScore
from lerobot_gloves.system.text import markdown_table
from lerobot_policy_csa_assist.editor import CSA
from lerobot_policy_csa_assist.edm import Denoiser, NoiseLevels
from lerobot_policy_ddpm_assist.configuration_ddpm_assist import DdpmAssistConfig
from lerobot_policy_ddpm_assist.diffusion import Diffusion, noise_scheduler
from lerobot_policy_ddpm_assist.editor import DDPM

CHUNK, ACTION, STATE, PROPOSALS = 10, 2, 16, 5
DEMO = {"width": 64, "depth": 3, "context_dim": 96}
"""The size of the demo's models, and of the baselines beside it."""


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


@dataclass(frozen=True)
class Method:
    """A method on a batch of chunks.

    Attributes:
        run: Does its work once, on the whole batch.
        fields: The fields that it evaluates; the first one's forward pass is what it is compared with.
        backward: Backward passes besides.
    """

    run: Callable[[], object]
    fields: tuple[BoundVelocity, ...]
    backward: int = 0


def make_network(kind: type[VelocityNetwork] = VelocityNetwork, **options: Any) -> VelocityNetwork:
    """A network of random weights everywhere: where its output layers are zero, as at first, passes do less work."""
    network = kind(ACTION, states={"state": STATE}, **options).eval().requires_grad_(False)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.02)
    return network


def methods(batch: int) -> dict[str, Method]:
    """Every method, with the settings that are best on Slalom or the paper's, on `batch` proposals."""
    observation, proposal = {"state": torch.randn(batch, STATE)}, torch.randn(batch, CHUNK, ACTION)
    generators, label = spawn(0, batch), torch.eye(len(SOURCES))
    aligned = make_network(goal=("source", len(SOURCES)), **DEMO)

    def field() -> BoundVelocity:
        return make_network(**DEMO).bind(observation)

    def source(name: str) -> BoundVelocity:
        return aligned.bind({**observation, "source": label[SOURCES.index(name)].expand(batch, -1)})

    def forward(velocity: BoundVelocity) -> Callable[[Tensor, Tensor], Tensor]:
        """Without what a backward pass would need, so that FEEG makes none."""
        return torch.no_grad()(velocity.__call__)

    def gate(steps: int) -> Method:
        velocity, score, decide = field(), ReverseScore(steps), ConformalGate(torch.rand(5000))
        return Method(torch.no_grad()(lambda: decide.admits(score(velocity, proposal))), (velocity,))

    def edits(editor: Any, expert: Any, *fields: BoundVelocity, backward: int = 0, **others: Any) -> Method:
        reference = Reference(expert, generator=generators, **others)
        return Method(lambda: editor(proposal, reference), fields, backward)

    def ifae(steps: int) -> Method:
        agent, expert = source("noised"), source("expert")
        return edits(IFAE(steps=steps), expert, agent, expert, agent=agent)

    def copilot(editor: Copilot) -> Method:
        """On its last five proposals; where it asks a score, with it."""
        expert = make_network(CopilotNetwork, proposals=PROPOSALS, **DEMO).bind(observation)
        proposals = torch.randn(batch, PROPOSALS, CHUNK, ACTION)
        posterior = told(expert, proposals, torch.ones(batch, PROPOSALS, dtype=torch.bool))
        fields = (posterior, expert) if editor.needs_threshold else (posterior,)
        return edits(editor, expert, *fields, posterior=posterior, score=ReverseScore(), threshold=0.0)

    feeg, forwards, backwards, search, noise, student = FEEG(steps=10), field(), field(), field(), field(), field()
    ddpm = DdpmAssistConfig(device="cpu")
    schedule = noise_scheduler(ddpm.schedule, ddpm.num_train_steps, ddpm.beta_min, ddpm.beta_max)
    diffusion, consistency = Diffusion(noise, schedule), Denoiser(student, NoiseLevels(), identity=0.002)
    return {
        "FEEG (10 steps), its forward passes alone": edits(feeg, forward(forwards), forwards),
        "FEEG (10 steps) with its backward passes": edits(feeg, backwards, backwards, backward=10),
        "IFAE (10 steps)": ifae(10),
        "IFAE (20 steps)": ifae(20),
        "FPAS (5 iterations of 16)": edits(FPAS(), search, search, score=ReverseScore(), threshold=0.0),
        "DDPM (gamma 0.3)": edits(DDPM(gamma=0.3), diffusion, noise),
        "CSA": edits(CSA(), consistency, student),
        "copilot, unlimited": copilot(Copilot(limit=-1)),
        "copilot": copilot(Copilot()),
        "one-step gate": gate(1),
        "five-step gate": gate(5),
    }


def side_by_side(batch: int, repeats: int) -> str:
    """The table of all methods."""
    proposal = torch.randn(batch, CHUNK, ACTION)
    header = ["method", "evaluations a chunk", "milliseconds a chunk", "forward passes"]
    lines = []
    for name, method in methods(batch).items():
        method.run()
        evaluations = str(sum(field.evaluations for field in method.fields))
        if method.backward:
            evaluations += f" + {method.backward} backward"
        one = method.fields[0]
        bare = torch.no_grad()(lambda one=one: one(proposal, times(0.5, proposal)))
        value, ours, _ = ratio(method.run, bare, repeats)
        lines.append([name, evaluations, f"{ours / batch:.3f}", f"{value:.1f}"])
    return markdown_table([header, *lines])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=30, help="environments side by side")
    parser.add_argument("--steps", type=int, default=10, help="steps of FEEG")
    parser.add_argument("--repeats", type=int, default=30, help="pairs of calls")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)

    network = make_network()
    velocity = network.bind({"state": torch.randn(arguments.batch, STATE)})
    proposal = torch.randn(arguments.batch, CHUNK, ACTION)
    reference = Reference(velocity, generator=spawn(0, arguments.batch))
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
            lambda: editor(proposal, reference), passes, arguments.repeats
        ),
        "one-step gate / one forward pass": ratio(gated, forward, 10 * arguments.repeats),
    }
    for batch in (1, arguments.batch):
        every = methods(batch)
        for name in ("copilot, unlimited", "copilot"):
            value = ratio(every[name].run, every["CSA"].run, 10 * arguments.repeats)
            rows[f"{name} / CSA" + (", one robot" if batch == 1 else "")] = value
    print(f"batch {arguments.batch}, one thread, torch {torch.__version__}")
    for name, (value, ours, bare) in rows.items():
        print(f"{name}: {value:.3f}x ({ours:.2f} ms / {bare:.2f} ms)")
    print(f"\n{side_by_side(arguments.batch, arguments.repeats)}")


if __name__ == "__main__":
    main()
