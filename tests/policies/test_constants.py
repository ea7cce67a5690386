"""What never changed in the demonstrations has no say in anything, and is passed on as it was proposed."""

from pathlib import Path

import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature
from lerobot.processor import NormalizerProcessorStep, PolicyProcessorPipeline
from lerobot.processor.converters import batch_to_transition, transition_to_batch
from safetensors.torch import load_file, save_file

from lerobot_gloves.checkpoints.statistics import Constants, action_range, action_units
from lerobot_gloves.faults import FAULTS, PROMPT, RandomisedAgents, Units
from lerobot_gloves.generators import spawn
from lerobot_gloves.perturbations import Shift
from tests.builders import observation, save_policy, wrap

LOCKED = 0.3
"""Where a joint was locked while the expert demonstrated."""


@pytest.fixture(scope="module", params=[0.0, 4e-5], ids=["no spread", "a spread of rounding"])
def locked(request, tmp_path_factory):
    """An adapter of an expert whose second action, and third entry of the state, never changed."""
    folder = save_policy(tmp_path_factory.mktemp("locked") / "adapter", "gloves_expert_flow", seed=7)
    for path in folder.glob("*normalizer_processor.safetensors"):
        known = load_file(path)
        for key, entry in (("action", 1), ("observation.state", 2)):
            for name in ("min", "max", "mean"):
                known[f"{key}.{name}"][entry] = LOCKED
            known[f"{key}.std"][entry] = request.param
        save_file(known, path)
    return folder


def corrected(checkpoints, adapter, *, shift: float = 0.0, told: float = 0.0, **options):
    """What becomes of a proposal whose second action is locked, but for a shift."""
    batch = observation(3)
    batch["observation.state"][:, 2] = LOCKED + told
    proposal = 0.002 * torch.randn(3, 6, 2, generator=torch.Generator().manual_seed(0))
    proposal[..., 1] = LOCKED + shift
    policy = wrap(checkpoints.agent, adapter=adapter, log=Path("/dev/null"), **options)
    return proposal, policy._corrector(batch, proposal, spawn(0, 3, stream="editor"))


@pytest.mark.parametrize("shift", [1e-7, 0.005, -2.0])
def test_a_locked_joint_has_no_say_and_is_passed_on(checkpoints, locked, shift):
    _, expected = corrected(checkpoints, locked, method="feeg:steps=2")
    proposal, found = corrected(checkpoints, locked, method="feeg:steps=2", shift=shift)
    assert torch.equal(found.action[..., 1], proposal[..., 1])
    assert torch.equal(found.action[..., 0], expected.action[..., 0])
    assert torch.equal(found.score, expected.score) and torch.equal(found.distance, expected.distance)
    assert found.edited.all() and (found.action[..., 0] != proposal[..., 0]).all()
    assert found.score.max() < 100 and 0 < found.distance.max() < 10


def test_a_state_that_never_changed_says_nothing(checkpoints, locked):
    _, expected = corrected(checkpoints, locked)
    _, found = corrected(checkpoints, locked, told=0.005)
    assert torch.equal(found.score, expected.score) and torch.equal(found.action, expected.action)


def test_it_reaches_the_robot_as_proposed(checkpoints, locked):
    """Through the wrapper, of a noisy agent that does not know of any lock."""
    policy = wrap(checkpoints.agent, adapter=locked, perturbation=Shift(dim=1, alpha=0.005, p=1.0))
    executed = torch.stack([policy.select_action(observation(2)) for _ in range(5)], dim=1)
    assert torch.equal(executed[..., 1], policy._plan.actions[:, :5, 1])
    assert (executed[..., 0] != policy._plan.actions[:, :5, 0]).all()


@pytest.mark.parametrize(
    ("mode", "names"),
    [
        (NormalizationMode.MEAN_STD, ("min", "max")),
        (NormalizationMode.MIN_MAX, ("min", "max")),
        (NormalizationMode.QUANTILES, ("q01", "q99")),
        (NormalizationMode.QUANTILE10, ("q10", "q90")),
    ],
)
def test_every_normalisation_divides_by_a_spread_of_its_own(mode, names):
    """Entries: one that changes, a locked one, one at rounding, and one that changes by half of a millionth."""
    low, high = names
    values = {low: [-1.0, 0.3, 0.3, 0.0], high: [1.0, 0.3, 0.3 + 1e-7, 5e-7]}
    known = {name: torch.tensor(given) for name, given in {"mean": values[low], "std": 4 * [0.1], **values}.items()}
    step = NormalizerProcessorStep(
        features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        norm_map={FeatureType.ACTION: mode},
        stats={"action": known},
    )
    constants = Constants(PolicyProcessorPipeline(steps=[step]))
    assert constants.action.tolist() == [False, True, True, False]
    held = constants.hold({"action": torch.tensor([[[0.5, 0.5, 0.5, 0.5]]]), "task": ["move"]})
    torch.testing.assert_close(held["action"].flatten(), torch.tensor([0.5, 0.3, 0.3, 0.5]))
    assert held["task"] == ["move"]
    assert (action_range(PolicyProcessorPipeline(steps=[step])) is None) == (low != "min")


def test_faults_leave_it_alone_and_do_not_measure_by_it():
    """Two of four entries are locked: the middling spread is of the other two, 0.1."""
    units = Units(zero=torch.tensor([-0.5, 0.0, 0.0, 0.2]), spread=torch.tensor([0.1, 1e-6, 1e-6, 0.2]))
    torch.testing.assert_close(units.alike()[[0, 3]], torch.tensor([1.0, 0.5]))
    history = torch.randn(400, 3, 5, 4, generator=torch.Generator().manual_seed(0))
    history[..., 1:3] = 0.0
    agents = RandomisedAgents(tuple(FAULTS), healthy=0.0, several=1.0)
    faulty = agents(history, units, torch.Generator().manual_seed(1))
    assert torch.equal(faulty[..., 1:3], history[..., 1:3])
    assert faulty.abs().max() < 100 and (faulty != history).any(dim=(1, 2, 3)).float().mean() > 0.8


def test_a_command_moves_what_moves_and_leaves_a_locked_joint_where_it_is():
    known = {"mean": [0.5, LOCKED], "std": [0.25, 0.0], "min": [0.0, LOCKED], "max": [1.0, LOCKED]}
    step = NormalizerProcessorStep(
        features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        norm_map={FeatureType.ACTION: NormalizationMode.MEAN_STD},
        stats={"action": {name: torch.tensor(given) for name, given in known.items()}},
    )
    preprocess = PolicyProcessorPipeline(steps=[step], to_transition=batch_to_transition, to_output=transition_to_batch)
    raw = torch.tensor([0.1, 0.2, 0.4])
    held = {"action": torch.stack([raw, torch.full((3,), LOCKED)], dim=-1)[None, None]}
    chunk = preprocess(held)["action"]
    command = PROMPT(chunk, action_units(preprocess, Constants(preprocess), held), torch.Generator().manual_seed(0))
    torch.testing.assert_close(command[0, 0, :, 0], torch.full((3,), (0.4 - 0.5) / 0.25))  # as fast as the expert is
    assert torch.equal(command[..., 1], chunk[..., 1])
