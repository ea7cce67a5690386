"""An align flow whose data would lose a whole source to the evaluation says so before the first step."""

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_tools import merge_datasets, modify_tasks
from lerobot.scripts import lerobot_train
from lerobot.scripts.lerobot_train import train

from tests.builders import training_options, write_dataset
from tests.policies.proposals import write_agent_dataset


class BeganError(Exception):
    """The policy is made, and training would begin."""


@pytest.fixture
def told(tmp_path, typed, monkeypatch):
    """What `lerobot-train` says to expert episodes of these instructions, merged with an agent's; None if it begins."""
    write_agent_dataset(tmp_path / "agent", np.zeros((4, 2, 6, 2)))

    def begin(*_):
        raise BeganError

    monkeypatch.setattr(lerobot_train, "make_optimizer_and_scheduler", begin)

    def told(instructions, *options):
        folder = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        expert = write_dataset(folder / "expert", episodes=len(instructions))
        expert = LeRobotDataset("me/expert", root=expert.root)
        modify_tasks(expert, episode_tasks=dict(enumerate(instructions)))
        parts = [LeRobotDataset("me/expert", root=expert.root), LeRobotDataset("me/agent", root=tmp_path / "agent")]
        merge_datasets(parts, "me/tiny", folder / "merged")
        typed(*training_options("gloves_align_flow", folder / "merged", folder / "run"), *options)
        try:
            train()
        except BeganError:
            return None
        except ValueError as error:
            return str(error)

    return told


def test_every_expert_held_out_is_told_at_the_start(told):
    line = told(["pick", "place", "push"])
    assert line.startswith(
        "gloves_align_flow: dataset.eval_split holds out all 3 episodes of the expert, as it does at l"
    )
    assert "lerobot-edit-dataset --operation.type=modify_tasks" in line and "\n" not in line


def test_who_keeps_some_of_everybody_trains(told):
    assert told(["pick", "pick", "push"]) is None
    assert told(["pick", "place", "push"], "--dataset.eval_split=0", "--eval_steps=0") is None
    # One side alone, as two checkpoints want it: nothing of the other was held out.
    assert told(["pick", "place", "push"], "--dataset.episodes=[3, 4, 5, 6]") is None
