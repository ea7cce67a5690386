"""LeRobot's commands in this process."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from lerobot.configs import parser
from lerobot.configs.eval import EvalPipelineConfig

from tests.builders import calibrate, save_policy


@dataclass
class Checkpoints:
    """Folders of a saved agent (`act`, 5 actions of its chunks) and a calibrated adapter (6 actions a chunk)."""

    agent: Path
    adapter: Path


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory) -> Checkpoints:
    folder = tmp_path_factory.mktemp("checkpoints")
    adapter = calibrate(save_policy(folder / "adapter", "gloves_expert_flow", seed=7))
    return Checkpoints(agent=save_policy(folder / "agent", "act"), adapter=adapter)


@pytest.fixture
def parse_eval(typed) -> Callable[..., Any]:
    """What `lerobot-eval` makes of its arguments."""

    @parser.wrap()
    def main(cfg: EvalPipelineConfig) -> EvalPipelineConfig:
        return cfg

    def parse(*arguments: str) -> EvalPipelineConfig:
        typed("--env.type=gloves_slalom", *arguments)
        return main()

    return parse
