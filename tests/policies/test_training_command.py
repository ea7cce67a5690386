import subprocess
import time
from pathlib import Path

import pytest
import torch
from lerobot.policies import get_policy_class
from lerobot.scripts.lerobot_train import train
from safetensors.torch import load_file

from tests.builders import CAMERA, observation, training_options, write_dataset
from tests.preloaded import server

LAST = Path("checkpoints") / "last"


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(tmp_path, typed, caplog):
    write_dataset(tmp_path / "data")
    output, log = tmp_path / "run", tmp_path / "log"
    with log.open("w") as stream:
        command = [
            server() / "lerobot-train",
            *training_options("gloves_expert_flow", tmp_path / "data", output),
        ]
        process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)
        try:
            while not (output / "checkpoints" / "000004" / "pretrained_model" / "train_config.json").exists():
                assert process.poll() is None, log.read_text()[-3000:]
                time.sleep(0.02)
            while (output / LAST).resolve().name < "000004":
                time.sleep(0.02)
        finally:
            process.kill()
            process.wait()
    reached = int((output / LAST).resolve().name)
    assert f"step {reached - 2}: eval_loss=" in log.read_text()
    weights = load_file(output / LAST / "pretrained_model" / "model.safetensors")
    assert weights["ema.n_averaged"] == reached  # LeRobot calls update() after every step

    config = output / LAST / "pretrained_model" / "train_config.json"
    typed(f"--config_path={config}", "--resume=true", f"--steps={reached + 3}")
    with caplog.at_level("INFO"):
        train()
    folder = output / LAST / "pretrained_model"
    assert int((output / LAST).resolve().name) == reached + 3
    resumed = get_policy_class("gloves_expert_flow").from_pretrained(folder)
    assert resumed.state_dict()["ema.n_averaged"] == reached + 3
    assert not torch.equal(resumed.state_dict()["network.dit.head.bias"], weights["network.dit.head.bias"])
    assert set(resumed.config.input_features) == {"observation.state", "observation.environment_state"}
    chunk = resumed.predict_action_chunk(observation(2))
    assert chunk.shape == (2, 6, 2) and chunk.isfinite().all()


def test_an_expert_flow_is_trained_on_pixels(tmp_path, typed):
    write_dataset(tmp_path / "data", "pixels_agent_pos")
    typed(*training_options("gloves_expert_flow", tmp_path / "data", tmp_path / "run", steps=2))
    train()
    folder = tmp_path / "run" / LAST / "pretrained_model"
    trained = get_policy_class("gloves_expert_flow").from_pretrained(folder)
    assert set(trained.config.input_features) == {"observation.state", CAMERA}
    assert trained.state_dict()["ema.n_averaged"] == 2
    batch = observation(2, "pixels_agent_pos")
    chunk = trained.predict_action_chunk(batch)
    assert chunk.shape == (2, 6, 2) and chunk.isfinite().all()
    trained.reset()
    other = trained.predict_action_chunk(batch | {CAMERA: 1 - batch[CAMERA]})
    assert not torch.equal(other, chunk), "the images count"


@pytest.mark.parametrize(
    ("kind", "missing", "message"),
    [
        ("gloves_flow_policy", ("observation.goal",), "no 'observation.goal', only observation.environment_state, "),
        (
            "gloves_expert_flow",
            ("observation.state", "observation.environment_state"),
            "nothing to be conditioned on; .* but holds only observation.goal",
        ),
    ],
)
def test_a_dataset_without_the_needed_features_is_one_clear_line(tmp_path, typed, kind, missing, message):
    write_dataset(tmp_path / "data", leave_out=missing)
    typed(*training_options(kind, tmp_path / "data", tmp_path / "run"))
    with pytest.raises(ValueError, match=message) as error:
        train()
    assert "\n" not in str(error.value)
