"""What a wrapper shows of its steps in LeRobot's viewer, beside what it returns and what its agent returns alone."""

import pytest
import torch

from tests.builders import observation, save_policy, wrap
from tests.viewer import Viewer

STEPS = 12


def act(policy) -> list[list[float]]:
    torch.manual_seed(0)
    with torch.inference_mode():
        return [policy.select_action(observation(seed=step))[0].tolist() for step in range(STEPS)]


@pytest.mark.parametrize("method", ["none", "feeg:start=0.5"])
@pytest.mark.parametrize("kind", ["diffusion", "gloves_expert_flow"])
def test_every_step_shows_what_was_proposed_and_what_is_executed(monkeypatch, tmp_path, checkpoints, kind, method):
    viewer = Viewer(monkeypatch)
    agent = save_policy(tmp_path / "agent", kind)
    alone = act(wrap(agent))
    policy = wrap(agent, adapter=checkpoints.adapter, method=method, display_data=True)
    executed = act(policy)
    shown = [step["action"] for step in viewer.shown]
    assert [step["executed"].tolist() for step in shown] == executed
    # An agent's draws do not depend on what was executed: it proposes what it does alone under these observations.
    assert [step["proposed"].tolist() for step in shown] == alone
    told = [step["observation"].get("gloves.edited") for step in viewer.shown]
    assert told[0] == float(method != "none") and None in told  # known where a proposal became due
    assert policy.unread == 0  # somebody looks at every step


def test_a_chunk_shows_its_first_action(monkeypatch, checkpoints):
    viewer = Viewer(monkeypatch)
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter, method="feeg:start=0.5", display_data=True)
    torch.manual_seed(0)
    chunk = policy.predict_action_chunk(observation())
    torch.manual_seed(0)
    proposal = wrap(checkpoints.agent).predict_action_chunk(observation())
    (told,) = viewer.shown
    assert told["action"]["executed"].tolist() == chunk[0, 0].tolist()
    assert told["action"]["proposed"].tolist() == proposal[0, 0].tolist() != chunk[0, 0].tolist()
    assert told["observation"]["gloves.edited"] == 1.0


@pytest.mark.parametrize("where", [{"display_ip": "192.0.2.7"}, {"display_port": 9876}])
def test_a_viewer_is_not_named_for_nothing(where, checkpoints):
    with pytest.raises(ValueError, match="without display_data nothing is shown"):
        wrap(checkpoints.agent, **where)
