"""What `gloves tune` recommends is what the wrapper does, unless the user says otherwise."""

import json
import logging

import pytest
import torch
from lerobot.policies import get_policy_class

from lerobot_gloves.checkpoints.calibration import weights_hash
from lerobot_gloves.checkpoints.content import checkpoint_hash
from lerobot_gloves.checkpoints.recommendation import RECOMMENDATION_NAME, Recommendation
from tests.builders import calibrate, observation, save_policy, wrap


@pytest.fixture
def adapter(tmp_path):
    return calibrate(save_policy(tmp_path / "adapter", "gloves_expert_flow"))


def recommend(adapter, **other) -> Recommendation:
    weights = weights_hash(get_policy_class("gloves_expert_flow").from_pretrained(adapter).state_dict())
    about = {"method": "feeg:start=0.3,steps=2,align=0.1", "gate": True, "score": "reverse:steps=1", "alpha": 0.2}
    made = Recommendation(**{**about, "repo_id": "me/expert", "chunks": 9, "weights": weights, **other})
    made.save(adapter)
    return made


def executed(*arguments, **options) -> torch.Tensor:
    policy = wrap(*arguments, **options)
    with torch.inference_mode():
        return policy.select_action(observation(2))


def test_it_acts_as_by_the_flags_that_it_stands_for(checkpoints, adapter, caplog):
    flags = recommend(adapter).flags
    assert flags == [
        "--policy.method=feeg:start=0.3,steps=2,align=0.1",
        "--policy.gate=true",
        "--policy.score=reverse:steps=1",
        "--policy.alpha=0.2",
    ]
    named = {"method": "feeg:start=0.3,steps=2,align=0.1", "gate": True, "alpha": 0.2}
    with caplog.at_level(logging.INFO):
        policy = wrap(checkpoints.agent, adapter=adapter)
    assert (
        "method feeg:start=0.3,steps=2,align=0.1 (recommended by gloves tune), gate at alpha 0.2 of chunks by "
        "reverse:steps=1" in caplog.text
    )
    assert policy._corrector.gate.test(4).gates[0].alpha == 0.2
    recommend(adapter, gate=False)
    ungated = executed(checkpoints.agent, adapter=adapter)
    assert torch.equal(ungated, executed(checkpoints.agent, adapter=adapter, **named | {"gate": False}))
    assert not torch.equal(ungated, executed(checkpoints.agent, adapter=adapter, method="none"))


def test_what_the_user_names_wins(checkpoints, adapter, caplog):
    recommend(adapter)
    settings = wrap(checkpoints.agent, adapter=adapter, alpha=0.5, gate=False)._corrector.settings
    assert (settings.method, settings.alpha, settings.gate) == ("feeg:start=0.3,steps=2,align=0.1", 0.5, False)
    with caplog.at_level(logging.INFO):
        settings = wrap(checkpoints.agent, adapter=adapter, method="feeg")._corrector.settings
    assert (settings.alpha, settings.gate, settings.recommended) == (0.05, False, False), "nothing of it is taken"
    assert "recommended" not in caplog.text


def test_one_for_other_weights_is_refused_unless_a_method_is_named(checkpoints, adapter):
    recommend(adapter, weights="0" * 64)
    with pytest.raises(
        ValueError, match=r"belongs to other weights .* run gloves tune again, or name --policy\.method"
    ):
        wrap(checkpoints.agent, adapter=adapter)
    wrap(checkpoints.agent, adapter=adapter, method="feeg")


@pytest.mark.parametrize("content", ["no JSON", "[]", '{"method": "feeg"}'])
def test_what_is_no_recommendation_is_told_so(adapter, content):
    (adapter / RECOMMENDATION_NAME).write_text(content)
    with pytest.raises(ValueError, match="is not a readable recommendation"):
        Recommendation.load(adapter)


def test_it_is_saved_along_with_the_weights_that_it_is_for(adapter, tmp_path):
    made = recommend(adapter)
    policy = get_policy_class("gloves_expert_flow").from_pretrained(adapter)
    policy.save_pretrained(tmp_path / "same")
    assert Recommendation.load(tmp_path / "same") == made
    with torch.no_grad():
        next(iter(policy.parameters())).add_(1.0)
    policy.save_pretrained(tmp_path / "other")
    assert Recommendation.load(tmp_path / "other") is None


def test_a_benchmarks_rows_are_those_of_before(adapter):
    """It names its methods, so that what is recommended decides nothing."""
    before = checkpoint_hash(str(adapter))
    recommend(adapter)
    assert checkpoint_hash(str(adapter)) == before
    config = json.loads((adapter / "config.json").read_text())
    (adapter / "config.json").write_text(json.dumps({**config, "guidance": 2.0}))
    assert checkpoint_hash(str(adapter)) != before
