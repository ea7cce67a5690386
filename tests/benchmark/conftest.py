"""Options of a benchmark that takes seconds."""

from pathlib import Path

import pytest

from lerobot_gloves.benchmark.setup import Setup
from lerobot_gloves.tasks.slalom import SlalomEnv

QUICK = ["--env.type=gloves_slalom", "--env.episode_length=20", "--episodes=3", "--num_workers=1"]


@pytest.fixture
def options(tmp_path: Path, agent: str, adapter: str) -> list[str]:
    return [*QUICK, f"--agent={agent}", f"--adapter={adapter}", f"--output_dir={tmp_path / 'rows'}"]


@pytest.fixture
def setup(agent: str, adapter: str) -> Setup:
    """What a cell of two episodes of Slalom is played with."""
    return Setup(env=SlalomEnv(), agent=agent, adapter=adapter, episodes=2)
