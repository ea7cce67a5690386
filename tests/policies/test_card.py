"""The model cards of adapters and agents: what they tell to type works, and what they say is so."""

import re
import shlex
from importlib.resources import files
from pathlib import Path

import pytest
from huggingface_hub import ModelCard
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.policies import get_policy_class

from lerobot_gloves.checkpoints.card import write_card
from tests.builders import calibrate, load, make_policy, save_policy

KINDS = ["gloves_expert_flow", "gloves_align_flow", "gloves_copilot", "ddpm_assist", "csa_assist"]


def pushed(kind: str, online, calibrated: bool = False, tmp_path: Path | None = None, **options) -> ModelCard:
    """The card of a policy that `lerobot-train` pushes at its end."""
    own = {"num_inference_steps": None} if kind == "ddpm_assist" else {}
    policy = make_policy(kind, **own, **options)
    if calibrated:
        folder = calibrate(save_policy(tmp_path / kind, kind, policy=policy))
        policy, _ = load(folder)
    policy.config.repo_id = "tester/mine"
    data = DatasetConfig(repo_id="tester/demonstrations", eval_split=0.1)
    training = TrainPipelineConfig(dataset=data, policy=policy.config, steps=12_000, batch_size=32, seed=5)
    policy.push_model_to_hub(training)
    return ModelCard(online.repositories["models", "tester/mine"].files["README.md"].decode())


@pytest.mark.parametrize("kind", KINDS)
def test_an_adapters_card_says_how_to_wrap_a_policy_in_it(kind, online, checkpoints, parse_eval):
    card = pushed(kind, online)
    assert card.data.datasets == "tester/demonstrations" and card.data.library_name == "lerobot"
    assert {"lerobot", "gloves", "adapter", kind} <= set(card.data.tags)
    assert ("flow-matching" in card.data.tags) == kind.startswith("gloves_")
    (command,) = re.findall(r"```bash\n(.*?)```", card.text, re.DOTALL)
    typed = command.replace("<your policy>", str(checkpoints.agent)).replace("<your environment>", "gloves_slalom")
    program, *options = shlex.split(typed.replace("\\\n", ""))
    assert program == "lerobot-eval" and "<" not in typed
    config = parse_eval(*options).policy
    assert (config.type, config.agent, config.adapter) == ("gloves", str(checkpoints.agent), "tester/mine")
    assert config.method is None and not config.gate
    assert "12,000 steps of 32 items, seed 5" in card.text and "10 % of its episodes held out" in card.text
    assert "`observation.state` (4,)" in card.text
    for editor in get_policy_class(kind).editors:
        assert f"`{editor}`" in card.text


def test_a_copilots_says_what_it_does_where_nobody_does(online, tmp_path):
    card = pushed("gloves_copilot", online, method="feeg:start=0.5")
    assert "without it, `feeg:start=0.5`." in card.text


def test_a_calibrated_ones_says_of_what_and_gates(online, tmp_path):
    card = pushed("gloves_expert_flow", online, calibrated=True, tmp_path=tmp_path)
    assert "--policy.gate=true" in card.text
    assert re.search(
        r"^\| calibration \| `reverse:steps=1`.*, on \d+ chunks of 2 episodes of `.+` \|$", card.text, re.M
    )


def test_a_copilots_says_what_faults_it_was_shown(online):
    card = pushed("gloves_copilot", online, faults=["noise", "replay"], healthy=0.25)
    assert (
        "| faults of its training | noise, replay; none in 25 % of the draws, two in 25 % of the others |" in card.text
    )


def test_an_agents_says_how_to_run_it(online):
    card = pushed("gloves_flow_policy", online)
    assert "adapter" not in card.data.tags and "--policy.wrap" not in card.text
    assert "lerobot-eval --policy.path=tester/mine" in card.text


def test_a_card_of_ours_or_lerobots_is_made_anew_and_anybody_elses_left_alone(tmp_path):
    folder = tmp_path / "flow"
    policy, _ = load(calibrate(save_policy(folder, "gloves_expert_flow")))
    card = folder / "README.md"
    write_card(folder, policy, {}, None, None)
    assert "| calibration | none:" in card.read_text()
    write_card(folder, policy, {}, policy.calibration, None)
    assert "| calibration | `reverse:steps=1`" in card.read_text() and str(tmp_path) not in card.read_text()
    card.write_text((files("lerobot.templates") / "lerobot_modelcard_template.md").read_text())
    write_card(folder, policy, {}, None, None)
    assert "| calibration | none:" in card.read_text()
    mine = card.read_text().replace("<!--", "<!-- mine ")
    card.write_text(mine)
    write_card(folder, policy, {}, policy.calibration, None)
    assert card.read_text() == mine
    act, _ = load(save_policy(tmp_path / "act", "act"))
    write_card(tmp_path, act, {}, None, None)
    assert not (tmp_path / "README.md").exists()
