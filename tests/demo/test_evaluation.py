import numpy as np
import pytest

from lerobot_gloves.demo.evaluation import ROLLED_OUT, Run, evaluation, perturbation_options, read
from tests.demo.episodes import CORRECTED, RAW, comparison, leave, played


@pytest.mark.parametrize(
    ("specification", "options"),
    [
        ("noised", ["type=noised", "sigma=0.005"]),
        ("shift:alpha=0.01,dim=0", ["type=shift", "dim=0", "alpha=0.01", "p=0.5"]),
        ("noised+laggy:p=0.3", ["type=compound", "parts=noised+laggy:p=0.3"]),
        ("none", []),
    ],
)
def test_perturbations_are_spelled_out(specification, options):
    assert perturbation_options(specification) == [f"--policy.perturbation.{option}" for option in options]


def test_unknown_perturbations_are_refused():
    with pytest.raises(ValueError, match=r"unknown perturbation 'jittery': choose from chatter, .*, slow, smooth"):
        perturbation_options("jittery")


def test_a_run_starts_afresh_and_leaves_other_runs_alone(tmp_path):
    (tmp_path / "fpas").mkdir()
    (tmp_path / "fpas" / "chunks.jsonl").write_text("of another run")
    (tmp_path / "feeg").mkdir()
    command = evaluation(comparison(tmp_path), Run("fpas", "FPAS", ["--policy.method=fpas"]))
    assert not (tmp_path / "fpas").exists() and (tmp_path / "feeg").exists()
    assert command.log == tmp_path / "fpas.log"
    assert {"--policy.method=fpas", "--seed=10000", "--eval.n_episodes=2", "--eval.batch_size=2"} <= set(command.words)


@pytest.mark.parametrize("episodes", [1, 2])
def test_what_a_run_left_is_read_back(tmp_path, episodes):
    result = played(CORRECTED, [10000, 10001][:episodes])
    result.chunks = [
        {"episode": 0, "step": 0, "length": 10, "edited": True, "distance": 0.3},
        {"episode": 0, "step": 10, "length": 10, "edited": False, "distance": 0.0},
    ]
    leave(result, tmp_path / CORRECTED.name)
    found = read(comparison(tmp_path, episodes), CORRECTED)
    assert found.successes == result.successes == [True] * episodes
    for mine, theirs in zip(found.actions, result.actions, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(found.set_points_and_tips, result.set_points_and_tips, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert found.chunks == result.chunks
    assert found.intervention_rate == 0.5 and found.distance == pytest.approx(0.15)


def test_the_raw_agent_has_no_chunk_log(tmp_path):
    leave(played(RAW, [10000, 10001]), tmp_path / RAW.name)
    found = read(comparison(tmp_path), RAW)
    assert found.intervention_rate is None and found.distance is None


def test_only_some_runs_are_recorded(tmp_path):
    assert "--eval.recording=true" in evaluation(comparison(tmp_path), RAW).words
    brief = Run("feeg", "FEEG")
    assert not any("recording" in option for option in evaluation(comparison(tmp_path), brief).words)
    leave(played(RAW, [10000, 10001]), tmp_path / "feeg")
    found = read(comparison(tmp_path), brief)
    assert found.successes == [True, True] and found.actions == [] == found.set_points_and_tips


def test_progress_is_found_in_what_lerobot_prints():
    line = (
        "Stepping through eval batches:   0%|          | 0/1 [00:00<?, ?it/s]\x1b[A\n"
        "Running rollout with at most 300 steps:   1%|▏         | 4/300 [00:01<01:28,  3.34it/s, success=0.0%]"
        "\rRunning rollout with at most 300 steps:  99%|█████████▉| 297/300 [02:18<00:00,  6.35it/s]"
    )
    *_, last = ROLLED_OUT.finditer(line)
    assert (last["done"], last["total"]) == ("297", "300")
