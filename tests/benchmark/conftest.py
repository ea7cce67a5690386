"""Options of a benchmark that takes seconds."""

from pathlib import Path

import pytest

QUICK = ["--env.type=gloves_slalom", "--env.episode_length=20", "--episodes=3", "--num_workers=1"]


@pytest.fixture
def options(tmp_path: Path, agent: str, adapter: str) -> list[str]:
    return [*QUICK, f"--agent={agent}", f"--adapter={adapter}", f"--output_dir={tmp_path / 'rows'}"]
