"""What the wrapper says of a whole run."""

import json

import torch

from lerobot_gloves.perturbations import Slow
from tests.builders import observation, wrap


def act(policy, batch, steps: int) -> None:
    with torch.inference_mode():
        for _ in range(steps):
            policy.select_action(batch)


def test_a_single_environment_that_stands_still_counts(checkpoints):
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter)
    act(policy, observation(1), 9)
    assert policy.statistics()["chunks"] == 2  # of 5 actions each


def test_totals_are_logged_at_the_end(checkpoints, caplog):
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter)
    with caplog.at_level("INFO"):
        policy._journal.report()
        assert "gloves:" not in caplog.text  # other tests may have left loggers talkative
        act(policy, observation(2), 4)
        policy._journal.report()
    assert "gloves: 2 chunks, 100.0 % edited, mean distance " in caplog.text


def test_the_log_says_which_proposals_were_perturbed(checkpoints, tmp_path):
    """Compared with the actions that the same agent, unperturbed, has for the same observations."""
    alone, log, count = wrap(checkpoints.agent), tmp_path / "log.jsonl", 8
    policy = wrap(
        checkpoints.agent, adapter=checkpoints.adapter, method="none", perturbation=Slow(alpha=0.5, p=0.5), log=log
    )
    policy.running = torch.ones(count, dtype=torch.bool)  # else what stands still counts as over
    changed, batch = [], observation(count)
    with torch.inference_mode():
        for _ in range(40):
            ours, its = policy.select_action(batch), alone.select_action(batch)
            if policy.correction is not None:
                changed += (ours != its).any(dim=1).tolist()
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(changed) >= 3 * count and 0 < sum(changed) < len(changed)
    assert [line["perturbed"] for line in lines] == changed
