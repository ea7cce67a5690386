"""What a cell's method becomes in the wrapper, and which methods an adapter allows."""

from typing import Any

import pytest
import torch

from lerobot_gloves.benchmark.cell import Cell
from lerobot_gloves.benchmark.play import run
from lerobot_gloves.benchmark.setup import Setup, load, resolve_method
from lerobot_gloves.evaluation.agent import load_agent
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.tasks.slalom import SlalomEnv


def setup_of(agent: str, adapter: str, **options: Any) -> Setup:
    return Setup(env=SlalomEnv(episode_length=20), agent=agent, adapter=adapter, episodes=2, **options)


def test_defaults_are_the_adapters_first(agent: str, adapter: str) -> None:
    assert resolve_method(setup_of(agent, adapter), "feeg", gate=True) == {
        "editor": "feeg:start=0.5,steps=10,align=1.0",
        "gate": True,
        "score": "reverse:steps=1",
        "alpha": 0.05,
    }
    assert (
        resolve_method(setup_of(agent, adapter, score="reverse:steps=5", alpha=0.2), "feeg", gate=False)["score"]
        == "reverse:steps=5"
    )


def test_an_adapter_without_scores(agent: str, diffusion: str) -> None:
    found = resolve_method(setup_of(agent, diffusion), "ddpm:gamma=0.3", gate=False)
    assert found == {"editor": "ddpm:gamma=0.3", "gate": False, "score": None, "alpha": None}
    for setup, gate in (
        (setup_of(agent, diffusion), True),
        (setup_of(agent, diffusion, score="reverse"), False),
    ):
        with pytest.raises(ValueError, match="a policy of type 'ddpm_assist' has no scores, and so no gate: leave out"):
            resolve_method(setup, "ddpm", gate=gate)
    episodes = run(setup_of(agent, diffusion), Cell("none", "ddpm:gamma=0.3", 0))
    assert all(episode.edited == episode.chunks > 0 for episode in episodes)


def test_options_reach_the_wrapper_with_the_perturbations_name(agent: str, adapter: str) -> None:
    options = {"adapter_overrides": ["--agent_source={perturbation}"], "adapter_rename_map": {"a": "b"}}
    setup = setup_of(agent, adapter, options=options)
    for perturbation, name in (("noised:sigma=0.01", "noised"), ("slow", "slow"), ("none", "none")):
        policy = load(setup, Cell(perturbation, "feeg", 0)).policy
        assert policy.config.adapter_overrides == [f"--agent_source={name}"]
        assert policy.config.adapter_rename_map == {"a": "b"}
    # A column has one description, whatever the line.
    assert resolve_method(setup, "feeg", gate=False)["options"] == options
    with pytest.raises(
        ValueError, match="no adapter option 'adapter_map': choose from adapter_overrides, adapter_rename"
    ):
        resolve_method(setup_of(agent, adapter, options={"adapter_map": {}}), "feeg", gate=False)


def test_the_raw_agent_has_no_adapter(agent: str, adapter: str) -> None:
    policy = load(setup_of(agent, adapter, score="reverse:steps=5"), Cell("none", "none", 0)).policy
    assert (policy.config.adapter, policy.config.score, policy.config.gate) == (None, None, None)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adapter_overrides": "--guidance=2"}, "adapter_overrides is '--guidance=2', but must be a list of options"),
        ({"adapter_overrides": [2]}, r"adapter_overrides is \[2\], but must be a list of options"),
        ({"adapter_rename_map": ["a"]}, r"adapter_rename_map is \['a'\], but must be observation keys by observation"),
    ],
)
def test_options_of_another_form_are_refused(agent: str, adapter: str, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        resolve_method(setup_of(agent, adapter, options=options), "feeg", gate=False)


@pytest.mark.parametrize("seed", [-1, 100])
def test_a_split_has_room_for_a_hundred_seeds(seed: int) -> None:
    with pytest.raises(ValueError, match=f"seed is {seed}, but must lie between 0 and 99"):
        Cell("none", "none", seed)


def test_a_raw_agent_has_nothing_to_gate() -> None:
    with pytest.raises(ValueError, match=r"method 'none\+gate' makes no sense: the raw agent has nothing"):
        Cell("none", "none", 0, gate=True)


@pytest.mark.parametrize("label", ["", "FEEG, gated"])
def test_a_column_is_its_label_or_its_editor_and_gate(label: str) -> None:
    assert Cell("slow", "feeg", 0, gate=True, label=label).column == (label or "feeg+gate")
    assert Cell("slow", "feeg", 0, label=label).column == (label or "feeg")
    assert Cell("slow", "none", 0, label=label).column == (label or "agent")


@pytest.mark.parametrize("perturbation", ["none", "noised:sigma=0.01"])
def test_the_same_start_is_played_otherwise_on_validation_seeds(agent: str, perturbation: str) -> None:
    """Slalom begins in 24 ways, so an episode of a search must not be one of the test."""
    cell, proposed = Cell(perturbation, "none", 3), {}
    for split in ("test", "validation"):
        wrapped = load(Setup(env=SlalomEnv(), agent=agent, episodes=2, split=split), cell)
        with environments(SlalomEnv(), 2) as env:
            observation, _ = env.reset(seed=[10_300, 10_301])
            proposed[split] = wrapped.act(env, observation)
    assert (proposed["test"] != proposed["validation"]).all()
    known = load_agent(SlalomEnv(), agent, perturbation, 3)
    with environments(SlalomEnv(), 2) as env:
        observation, _ = env.reset(seed=[10_300, 10_301])
        assert torch.equal(known.act(env, observation), proposed["test"])
