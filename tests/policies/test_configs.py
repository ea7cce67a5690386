"""The shipped training configurations, read as `lerobot-train --config_path` reads them, without data or weights.

What makes one of them a task's is read from docs/reproduce.md, as a user does.
"""

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest
import yaml
from lerobot.configs import parser
from lerobot.configs.train import TrainPipelineConfig

from lerobot_gloves.demo import EXPERT_FLOW, PACKAGED
from scripts.train_models import OPTIONS

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
REPRODUCE = (ROOT / "docs" / "reproduce.md").read_text()
TASKS = {"slalom": "Slalom", "keypad": "Keypad", "can": "CAN", "charger": "Charger"}
"""And what the pages call them."""
TYPES = {
    "agent": "gloves_flow_policy",
    "expert_flow": "gloves_expert_flow",
    "align_flow": "gloves_align_flow",
    "ddpm_assist": "ddpm_assist",
    "csa_teacher": "csa_assist",
    "csa_student": "csa_assist",
    "copilot": "gloves_copilot",
}
OURS = {"copilot"}
"""Of these, what the paper does not have."""
PERSONS = "copilot_person"
"""The copilot for a person at the controls, which no benchmark plays."""
FLOW = {"context_dim": 256, "width": 128, "mlp_ratio": 4}
ALIGN = {"context_dim": 512, "width": 512, "mlp_ratio": 2}
MODEL = {
    "heads": 4,
    "dropout": 0.1,
    "time_dim": 256,
    "visual_dropout": 0.1,
    "chunk_size": 10,
    "n_action_steps": 10,
    "depth": 4,  # ours: the paper does not say
}
"""What all have in common in the paper's table (a)."""
TRAINING = {
    "optimizer_lr": 3e-4,
    "optimizer_lr_backbone": 3e-5,
    "optimizer_weight_decay": 1e-3,
    "optimizer_betas": (0.9, 0.999),
}
"""Its table (b), as far as the policy says."""


def documented_options() -> dict[tuple[str, str], list[str]]:
    """By task and model, the options over configs/cpu/<model>.yaml that the page lists."""
    found = {}
    for tasks, models, options in re.findall(r"^\| ([\w, ]+) \| ([\w`, ]+) \| (none|`--.+`) \|$", REPRODUCE, re.M):
        named = TYPES if models == "all" else re.findall(r"`(\w+)`", models)
        for name, kind in product(tasks.split(", "), named):
            task = next(task for task in TASKS if TASKS[task] == name)
            assert (task, kind) not in found
            found[task, kind] = [] if options == "none" else options.strip("`").split()
    return found


def documented_steps() -> dict[str, int]:
    """By task, the steps over configs/paper/<model>.yaml that the page lists."""
    found = dict(re.findall(r"^\| (\w+) \| \d+ \| (\d+) \|$", REPRODUCE, re.M))
    return {task: int(found[name]) for task, name in TASKS.items()}


@pytest.fixture
def read(typed, tmp_path):
    @parser.wrap()
    def lerobot_train(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
        cfg.validate()
        return cfg

    def read(scale: str, kind: str, *options: str) -> TrainPipelineConfig:
        file = CONFIGS / scale / f"{kind}.yaml"
        typed(f"--config_path={file}", "--dataset.repo_id=me/mine", f"--output_dir={tmp_path / 'new'}", *options)
        config = lerobot_train()
        assert config.policy.type == TYPES[kind]
        if config.policy.type == "csa_assist":
            assert config.policy.stage == kind.removeprefix("csa_")
        assert config.dataset.eval_split == 0.1 and not config.policy.push_to_hub
        return config

    return read


def test_no_file_is_left_out():
    assert {file.name for file in (CONFIGS / "own").iterdir()} == {"state.yaml", "cameras.yaml"}
    for scale, kinds in (("cpu", {*TYPES, PERSONS}), ("paper", TYPES.keys() - OURS)):
        assert {file.name for file in (CONFIGS / scale).iterdir()} == {f"{kind}.yaml" for kind in kinds}


def test_the_copilot_for_people_differs_by_what_people_do(typed, tmp_path):
    file, other = (yaml.safe_load((CONFIGS / "cpu" / f"{name}.yaml").read_text()) for name in (PERSONS, "copilot"))
    theirs = {"decision_every": 1, "history": 10, "faults": ["driven"], "healthy": 0.1}
    theirs |= {"method": "feeg:start=0.4,steps=5,align=0.0", "gate_score": "reverse:steps=5", "gate_alpha": 0.1}
    assert file == other | {"policy": other["policy"] | theirs}

    @parser.wrap()
    def lerobot_train(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
        cfg.validate()
        return cfg

    path = CONFIGS / "cpu" / f"{PERSONS}.yaml"
    typed(f"--config_path={path}", "--dataset.repo_id=me/mine", f"--output_dir={tmp_path / 'new'}")
    assert lerobot_train().policy.action_delta_indices == list(range(-10, 10))  # half a second back


@pytest.mark.parametrize("name", ["state", "cameras"])
def test_a_file_for_own_data_saves_and_tells_the_held_out_loss_long_before_its_end(typed, tmp_path, name):
    @parser.wrap()
    def lerobot_train(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
        cfg.validate()
        return cfg

    typed(
        f"--config_path={CONFIGS / 'own' / name}.yaml", "--dataset.repo_id=me/mine", f"--output_dir={tmp_path / 'new'}"
    )
    config = lerobot_train()
    assert config.policy.type == "gloves_copilot" and not config.policy.push_to_hub
    assert config.dataset.eval_split > 0 and config.eval_steps == config.save_freq <= config.steps / 4


def test_no_file_names_a_dataset_that_a_user_might_train_on_by_mistake(typed, capsys):
    files = [file for scale in ("cpu", "paper", "own") for file in (CONFIGS / scale).iterdir()]
    assert all("repo_id" not in yaml.safe_load(file.read_text())["dataset"] for file in files)

    @parser.wrap()
    def lerobot_train(cfg: TrainPipelineConfig) -> None:
        pytest.fail("it went on without")

    typed(f"--config_path={files[0]}")
    with pytest.raises(SystemExit):
        lerobot_train()
    assert "Missing required field(s) `repo_id`" in capsys.readouterr().err


def test_the_page_lists_the_options_by_which_the_benchmarks_models_are_trained():
    options = documented_options()
    assert set(options) == set(product(TASKS, TYPES))
    trained = {
        (task, kind): [f"--{name}={value}" for name, value in OPTIONS.get(task, {}).get(kind, {}).items()]
        for task, kind in product(TASKS, TYPES)
    }
    assert {key: sorted(value) for key, value in options.items()} == {k: sorted(v) for k, v in trained.items()}
    assert {task.removesuffix("_pixels") for task in OPTIONS} <= TASKS.keys()


@pytest.mark.parametrize("task", [task for task in OPTIONS if task.endswith("_pixels")])
def test_the_page_lists_those_of_models_with_cameras_too(task):
    page = (
        (ROOT / "docs" / "reproduce.md").read_text().partition("## With cameras on two cores")[2].partition("\n## ")[0]
    )
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| `(.+)` \|$", page, re.M)
    listed = {kind: set(options.split(" --")) for kinds, options in rows for kind in re.findall(r"\w+", kinds)}
    seen = f"outputs/{task}/expert_flow/checkpoints/last/pretrained_model"
    trained = {
        kind: {f"{name}={value}".replace(seen, "<the expert flow's checkpoint>") for name, value in options.items()}
        for kind, options in OPTIONS[task].items()
    }
    assert {kind: {one.removeprefix("--") for one in options} for kind, options in listed.items()} == trained


@pytest.mark.parametrize("page", [*TASKS, "adapters"])
def test_the_commands_on_other_pages_have_them_too(page):
    text = (ROOT / "docs" / f"{page}.md").read_text().replace("\\\n", " ")
    commands = re.findall(r"^lerobot-train --config_path=configs/cpu/(\w+)\.yaml (.+)$", text, re.M)
    assert len(commands) == 2
    for kind, given in commands:
        own = {one for one in given.split() if not one.startswith(("--dataset.", "--output_dir="))}
        assert own == set(documented_options()["slalom" if page == "adapters" else page, kind])


def test_every_paper_file_says_how_many_steps_500_epochs_are():
    steps = documented_steps()
    for file in (CONFIGS / "paper").iterdir():
        comment = next(line for line in file.read_text().splitlines() if line.startswith("# 500 epochs"))
        told = re.findall(r"(\d{5,}) of (\w+)'s", comment)
        assert {name: int(number) for number, name in told} == {TASKS[task]: steps[task] for task in TASKS}


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("task", ["slalom", "keypad", "charger"])
def test_a_file_for_two_cores_and_a_tasks_options_train_what_they_say(read, task, kind):
    config = read("cpu", kind, *documented_options()[task, kind])
    assert config.steps <= 15_000
    assert config.policy.chunk_size == config.policy.n_action_steps == (2 if task == "charger" else 10)


def test_can_is_trained_as_keypad_is():
    options = documented_options()
    assert all(options["can", kind] == options["keypad", kind] for kind in TYPES)


@pytest.mark.parametrize("kind", sorted(TYPES.keys() - OURS))
def test_a_file_at_the_papers_scale_has_the_papers_sizes(read, kind):
    config = read("paper", kind, "--steps=40000")
    sizes = (ALIGN if kind == "align_flow" else FLOW) | MODEL | TRAINING
    if config.policy.type != "csa_assist":  # it always knows its context
        sizes["context_dropout"] = 0.2
    assert {name: getattr(config.policy, name) for name in sizes} == sizes
    assert config.policy.pretrained_backbone_weights == "ResNet18_Weights.IMAGENET1K_V1"
    assert (config.batch_size, config.policy.samples_per_item, config.steps) == (256, 1, 40_000)


def values(file: Path, options: Sequence[str] = ()) -> dict[str, str]:
    """All that a file says, and options over it, as one would type it."""
    said = yaml.safe_load(file.read_text())
    said |= {f"policy.{name}": value for name, value in said.pop("policy").items()}
    return {name: str(value) for name, value in said.items()} | dict(one[2:].split("=") for one in options)


@pytest.mark.parametrize("task", TASKS)
def test_the_baselines_are_trained_as_the_expert_flow_that_they_are_compared_with(task):
    flow = values(CONFIGS / "cpu" / f"{EXPERT_FLOW}.yaml", documented_options()[task, EXPERT_FLOW])
    if task == "slalom":  # the demo's
        flow = values(PACKAGED / f"{EXPERT_FLOW}.yaml")
    for kind in ("ddpm_assist", "csa_teacher", "csa_student"):
        found = values(CONFIGS / "cpu" / f"{kind}.yaml", documented_options()[task, kind])
        different = {name for name in flow | found if flow.get(name) != found.get(name)}
        assert different <= {"dataset", "policy.type", "policy.stage"}
