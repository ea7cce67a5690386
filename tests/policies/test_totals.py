"""What the wrapper says of a whole run."""

import torch

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
    assert "2 chunks, intervention rate 1.000" in caplog.text
