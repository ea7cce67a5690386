"""Every kind of method plays the same episodes whenever it is asked."""

import shutil
from pathlib import Path

import pytest
import torch

from lerobot_gloves.benchmark.folder import read_rows
from tests.benchmark.test_bench import gloves, without_times
from tests.builders import calibrate

FILE = """
episodes: 3
num_workers: 1
tasks:
  short:
    env: {{type: gloves_slalom, episode_length: 20}}
    agent: {agent}
    perturbations: {{noised: "noised:sigma=0.0035"}}
    methods:
      agent: {{editor: none}}
      DDPM: {{adapter: {diffusion}, editor: "ddpm:gamma=0.3"}}
      CSA: {{adapter: {student}, editor: "csa:level=35"}}
      FPAS: {{adapter: {adapter}, editor: "fpas:iterations=2,candidates=4"}}
      FEEG: {{adapter: {adapter}, editor: "feeg:start=0.4"}}
      FEEG+gate: {{adapter: {adapter}, editor: "feeg:start=0.4", gate: true}}
      IFAE: {{adapter: {align_flow}, editor: "ifae:steps=4", options: &told {{adapter_overrides: [{source}]}}}}
      IFAE+gate: {{adapter: {calibrated}, editor: "ifae:steps=4", options: *told, gate: true}}
"""
METHODS = ("agent", "DDPM", "CSA", "FPAS", "FEEG", "FEEG+gate", "IFAE", "IFAE+gate")


@pytest.fixture
def file(tmp_path: Path, agent: str, adapter: str, align_flow: str, diffusion: str, student: str) -> str:
    """A matrix with every kind of method."""
    calibrated = Path(shutil.copytree(align_flow, tmp_path / "calibrated"))
    scores = {"reverse:steps=1": torch.linspace(0, 30, 200).expand(6, -1)}
    path = tmp_path / "bench.yaml"
    source = "--agent_source={perturbation}"
    path.write_text(
        FILE.format(
            agent=agent,
            adapter=adapter,
            align_flow=align_flow,
            calibrated=calibrate(calibrated, scores=scores),
            diffusion=diffusion,
            student=student,
            source=f'"{source}"',
        )
    )
    return f"--config_path={path}"


def test_each_method_plays_the_same_episodes_again(tmp_path: Path, file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All in one run, then in pairs from the other end: others have been played before, with other draws."""
    assert gloves(monkeypatch, "bench", file, f"--output_dir={tmp_path / 'together'}") == ""
    together = {row.cell.label: row for row in without_times(read_rows(tmp_path / "together"))}
    assert together.keys() == set(METHODS)
    for pair in (METHODS[6:], METHODS[4:6], METHODS[2:4], METHODS[:2]):
        again = tmp_path / pair[0]
        only = [f"--methods=[{', '.join(pair)}]", f"--output_dir={again}"]
        assert gloves(monkeypatch, "bench", file, *only) == ""
        for row in without_times(read_rows(again)):
            assert row == together[row.cell.label]
    # What is compared is not the raw agent eight times.
    distances = {label: sum(episode.distance for episode in row.episodes) for label, row in together.items()}
    assert distances["agent"] == 0.0
    assert len(set(distances.values())) == len(METHODS), distances
