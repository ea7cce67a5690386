"""docs/your_robot.md, command by command as it stands there: only sizes are made small, and the Hub is a stand-in."""

import json
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from huggingface_hub import HfApi, ModelCard
from lerobot.datasets import LeRobotDataset

from lerobot_gloves.benchmark.folder import read_rows
from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME, Calibration
from tests.hub import USER
from tests.preloaded import PROGRAMS, server

ROOT = Path(__file__).parents[1]
DATA = "lerobot/pusht_keypoints"
EPISODES, LENGTH = 20, 80
NETWORK = "--policy.dim_model=32 --policy.dim_feedforward=32 --policy.n_heads=2 --policy.n_encoder_layers=1"
PLAYED = "--eval.n_episodes=2 --eval.batch_size=2 --env.episode_length=12"
SMALL = {
    "outputs/pusht/agent": f"--steps=4 --save_freq=4 --batch_size=4 --num_workers=0 {NETWORK}",
    "outputs/pusht/raw": PLAYED,
    "outputs/pusht/copilot": "--steps=20 --save_freq=20 --eval_steps=20 --batch_size=16 --policy.width=32 "
    "--policy.samples_per_item=4 --policy.depth=1 --policy.context_dim=32",
    "gloves check": "--chunks=40",
    "gloves calibrate": "--stride=5",
    "outputs/pusht/corrected": PLAYED,
    "outputs/pusht/bench": "--episodes=2 --batch_size=2 --env.episode_length=12 --num_workers=1",
    "gloves push": "",
    "outputs/pusht/from_the_hub": PLAYED,
    "gloves replay": "",
}
"""By what tells a command from the others, the options that make it small; in the page's order."""


def commands() -> list[str]:
    """What the page tells to type, a line each."""
    page = (ROOT / "docs" / "your_robot.md").read_text()
    blocks = re.findall(r"```bash\n(.*?)```", page, re.DOTALL)
    return [line for block in blocks for line in block.replace("\\\n", "").splitlines()]


def name_of(command: str) -> str:
    """Which command of `SMALL` it is: by its output folder, or else by its name."""
    output = re.search(r"--output_dir=(\S+)", command)
    return output[1] if output else " ".join(command.split()[:2])


def demonstrations(root: Path) -> Path:
    """As `lerobot/pusht_keypoints` has them, of a hand that goes to the middle of the T."""
    vector = {"observation.state": 2, "observation.environment_state": 16, "action": 2, "next.reward": 1}
    features = {key: {"dtype": "float32", "shape": (size,), "names": None} for key, size in vector.items()}
    features |= {key: {"dtype": "bool", "shape": (1,), "names": None} for key in ("next.done", "next.success")}
    dataset = LeRobotDataset.create(DATA, fps=10, root=root, features=features, use_videos=False)
    env = gym.make("gym_pusht/PushT-v0", obs_type="environment_state_agent_pos")
    for episode in range(EPISODES):
        seen, _ = env.reset(seed=episode)
        for _ in range(LENGTH):
            middle = seen["environment_state"].reshape(8, 2).mean(axis=0)
            action = seen["agent_pos"] + 0.3 * (middle - seen["agent_pos"])
            row = {"observation.state": seen["agent_pos"], "observation.environment_state": seen["environment_state"]}
            seen, reward, done, _, info = env.step(action)
            row |= {"action": action, "next.reward": [reward]}
            frame = {key: np.asarray(value, np.float32) for key, value in row.items()}
            frame |= {"next.done": np.array([done]), "next.success": np.array([info["is_success"]])}
            dataset.add_frame(frame | {"task": "Push the T-shaped block onto the T-shaped target."})
        dataset.save_episode()
    dataset.finalize()
    return root


def test_what_is_installed_is_what_the_page_needs():
    install, *typed = commands()
    assert install == "pip install '.[pusht]'"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "lerobot[pusht]" in project["optional-dependencies"]["pusht"]
    assert {command.split()[0] for command in typed} <= set(PROGRAMS)
    assert [name_of(command) for command in typed] == list(SMALL)


@pytest.mark.slow
def test_the_page_leads_from_nothing_to_a_policy_that_is_corrected_from_the_hub(tmp_path, online, monkeypatch):
    import gym_pusht  # noqa: F401, registers it

    api = HfApi()
    api.create_repo(DATA, repo_type="dataset")
    api.upload_folder(repo_id=DATA, repo_type="dataset", folder_path=demonstrations(tmp_path / "data"))
    api.create_tag(DATA, tag="v3.0", repo_type="dataset")
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_ENDPOINT", online.url)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "home"))
    printed = {}
    for command in commands()[1:]:
        name = name_of(command)
        program, *options = shlex.split(f"{command.replace('<you>', USER)} {SMALL[name]}")
        done = subprocess.run([server() / program, *options], capture_output=True, text=True)
        printed[name] = done.stderr + done.stdout
        status = 1 if name == "gloves check" and "\nnot usable: " in done.stdout else 0
        assert done.returncode == status, f"{name}: {done.stderr[-3000:]}"

    # What the page says of each.
    assert "eval_loss=" in printed["outputs/pusht/copilot"]
    assert printed["gloves check"].splitlines()[-1].startswith(("usable: ", "not usable: "))
    assert "torchcodec" not in printed["gloves check"] + printed["gloves calibrate"]
    assert "the smallest alpha of a gate: " in printed["gloves calibrate"]
    folder = Path("outputs/pusht/copilot/checkpoints/last/pretrained_model")
    calibrated = Calibration.load(folder)
    assert calibrated.repo_id == DATA and calibrated.episodes == (18, 19)
    for run in ("raw", "corrected", "from_the_hub"):
        (task,) = json.loads(Path(f"outputs/pusht/{run}/eval_info.json").read_text())["per_task"]
        assert len(task["metrics"]["successes"]) == 2, run
    lines = [json.loads(line) for line in Path("outputs/pusht/log.jsonl").read_text().splitlines()]
    assert len(lines) == 4, "two episodes of 12 steps, of which the agent plans 8 at a time"
    assert "2 episodes, 4 chunks" in printed["gloves replay"] and Path("outputs/pusht/replay.html").is_file()
    played = {(row.cell.perturbation, row.cell.editor) for row in read_rows(Path("outputs/pusht/bench"))}
    assert played == {(kind, method) for kind in ("none", "laggy:p=0.3") for method in ("none", "copilot")}

    files = online.repositories["models", f"{USER}/pusht_copilot"].files
    assert {"model.safetensors", "config.json", CALIBRATION_NAME} < set(files)
    card = ModelCard(files["README.md"].decode())
    assert f"--policy.adapter={USER}/pusht_copilot" in card.text and f"episodes of `{DATA}`" in card.text
    assert f"adapter {USER}/pusht_copilot" in printed["outputs/pusht/from_the_hub"]
