"""The baseline `csa_assist` through LeRobot's training command, and what it refuses."""

import shutil
from pathlib import Path

import pytest
import torch
from lerobot.scripts.lerobot_train import train
from safetensors.torch import load_file

from lerobot_policy_csa_assist.editor import CSA
from tests.builders import training_options, write_dataset
from tests.policies.test_csa_assist import WEIGHTS, data_of, load, make_csa

LAST = Path("checkpoints") / "last"


@pytest.mark.slow
def test_both_stages_train_and_resume_by_lerobots_command(tmp_path, typed):
    data = tmp_path / "data"
    write_dataset(data)

    def resume(output: Path, steps: int) -> dict[str, torch.Tensor]:
        before = load_file(output / LAST / "pretrained_model" / WEIGHTS)
        config = output / LAST / "pretrained_model" / "train_config.json"
        typed(f"--config_path={config}", "--resume=true", f"--steps={steps}")
        train()
        after = load_file(output / LAST / "pretrained_model" / WEIGHTS)
        assert (int(before["ema.n_averaged"]), int(after["ema.n_averaged"])) == (steps - 2, steps)
        assert not torch.equal(before["network.dit.head.bias"], after["network.dit.head.bias"])
        return after

    typed(*training_options("csa_assist", data, tmp_path / "teacher", steps=2))
    train()
    weights = resume(tmp_path / "teacher", 4)
    teacher = tmp_path / "teacher" / LAST / "pretrained_model"

    distil = ["--policy.stage=student", f"--policy.teacher={teacher}"]
    typed(*training_options("csa_assist", data, tmp_path / "student", steps=2), *distil)
    train()
    trained = resume(tmp_path / "student", 4)
    assert trained.keys() == weights.keys()
    shutil.rmtree(tmp_path / "teacher")
    student = load(tmp_path / "student" / LAST / "pretrained_model")
    assert student.config.stage == "student"
    assert set(student.config.input_features) == {"observation.state", "observation.environment_state"}
    batch = data_of(2)
    assert student.bind(batch).edit(batch["action"], CSA()).isfinite().all()

    typed(*training_options("csa_assist", data, tmp_path / "again", steps=2), *distil)
    with pytest.raises(
        ValueError, match=r"--policy\.teacher=.* is no checkpoint's folder, nor one on the Hub"
    ) as error:
        train()
    assert "\n" not in str(error.value)


def test_a_wrong_stage_reaches_who_typed_it_as_one_line(tmp_path, typed):
    write_dataset(tmp_path / "data", episodes=4, length=8)
    typed(*training_options("csa_assist", tmp_path / "data", tmp_path / "run", steps=2), "--policy.stage=pupil")
    with pytest.raises(ValueError, match=r"^csa_assist has no stage 'pupil': choose from teacher, student$"):
        train()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stage": "pupil"}, "csa_assist has no stage 'pupil': choose from teacher, student"),
        ({"stage": "student"}, "a student is distilled from a teacher: name its checkpoint, --policy.teacher"),
        ({"stage": "student", "teacher": "a/b/c"}, "--policy.teacher=a/b/c is no checkpoint's folder, nor one on the"),
        ({"stage": "student", "teacher": "me/none"}, "--policy.teacher=me/none is no checkpoint's folder, nor one on"),
        (
            {"stage": "student", "teacher": "x", "context_dropout": 0.2},
            "context_dropout must be 0 and guidance 1, not 0.2",
        ),
        (
            {"stage": "student", "teacher": "x", "guidance": 2.0},
            "context_dropout must be 0 and guidance 1, not 0.0 and 2.0",
        ),
        ({"sigma_min": 0.0}, "sigma_min is 0.0 and sigma_max is 80.0, but 0 < sigma_min < sigma_max must hold"),
        ({"sigma_max": 0.001}, "sigma_min is 0.002 and sigma_max is 0.001, but"),
        ({"levels": 1}, "levels is 1, but must be at least 2"),
        ({"num_inference_steps": 0}, "num_inference_steps is 0, but must be at least 1"),
        ({"sigma_data": 0.0}, "sigma_data is 0.0, but must be above 0"),
        ({"rho": -7.0}, "rho is -7.0, but must be above 0"),
    ],
)
def test_impossible_options_are_one_clear_line(options, message):
    with pytest.raises(ValueError) as error:
        make_csa(**options)
    assert message in str(error.value) and "\n" not in str(error.value)
