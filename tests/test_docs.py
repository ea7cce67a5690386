"""What the pages say of the code is true: the table of options, and the README's example."""

import re
from dataclasses import fields
from pathlib import Path

import torch
from lerobot.policies import get_policy_class

import lerobot_policy_gloves  # noqa: F401, registers the adapters
from lerobot_gloves.perturbations import PERTURBATIONS
from lerobot_gloves.scores import SCORES
from tests.gaussian import example_flow, seeded

ROOT = Path(__file__).parents[1]
ADAPTERS = ("gloves_expert_flow", "gloves_align_flow", "ddpm_assist", "csa_assist")


def test_the_table_of_options_is_that_of_the_classes():
    section = (ROOT / "docs" / "adapters.md").read_text().partition("\n## Options\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (\S+) \| .+ \|$", section, re.MULTILINE)
    editors = {name: editor for kind in ADAPTERS for name, editor in get_policy_class(kind).editors.items()}
    choices = {**editors, **SCORES, **PERTURBATIONS}
    assert len(choices) == len(editors) + len(SCORES) + len(PERTURBATIONS)  # a name says what it is
    expected = [(name, one.name, repr(one.default)) for name, choice in choices.items() for one in fields(choice)]
    assert sorted(rows) == sorted(expected)


def test_the_readmes_example_edits_what_the_gate_turns_away():
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    velocity = example_flow()
    proposal = velocity.sample(4, seeded(1))
    proposal[0], proposal[2] = velocity.mean, velocity.mean + 8 * velocity.std  # the likeliest chunk, and none at all
    names = {"velocity": velocity, "held_out_chunks": velocity.sample(200, seeded(0)), "proposal": proposal.clone()}
    torch.manual_seed(0)
    exec(code, names)
    admitted = names["admitted"]
    assert admitted[0] and not admitted[2]
    assert torch.equal(names["chunk"][admitted], proposal[admitted])
    assert (names["chunk"] - velocity.mean)[2].norm() < (proposal - velocity.mean)[2].norm()
