"""The shipped training configurations, read as `lerobot-train --config_path` reads them, without data or weights."""

from pathlib import Path

import pytest
from lerobot.configs import parser
from lerobot.configs.train import TrainPipelineConfig

CONFIGS = Path(__file__).parents[2] / "configs"
TASKS = ("slalom", "keypad", "can", "charger")
TYPES = {
    "agent": "gloves_flow_policy",
    "expert_flow": "gloves_expert_flow",
    "align_flow": "gloves_align_flow",
    "ddpm_assist": "ddpm_assist",
    "csa_teacher": "csa_assist",
    "csa_student": "csa_assist",
}
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


@pytest.fixture
def read(typed, tmp_path):
    @parser.wrap()
    def lerobot_train(cfg: TrainPipelineConfig) -> TrainPipelineConfig:
        cfg.validate()
        return cfg

    def read(scale: str, task: str, kind: str) -> TrainPipelineConfig:
        file = CONFIGS / scale / f"{task}_{kind}.yaml"
        typed(f"--config_path={file}", f"--output_dir={tmp_path / 'new'}")
        return lerobot_train()

    return read


def test_no_file_is_left_out():
    expected = {f"{task}_{kind}.yaml" for task in TASKS for kind in TYPES}
    for scale in ("cpu", "paper"):
        assert {file.name for file in (CONFIGS / scale).iterdir()} == expected


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("scale", ["cpu", "paper"])
def test_a_file_trains_what_its_name_says_at_the_scale_of_its_folder(read, scale, task, kind):
    config = read(scale, task, kind)
    assert config.policy.type == TYPES[kind]
    if config.policy.type == "csa_assist":
        assert config.policy.stage == kind.removeprefix("csa_")
    assert config.dataset.repo_id.startswith(f"gloves/{task}_")
    assert ("align" in config.dataset.repo_id) == (kind == "align_flow")
    assert ("pixels" in config.dataset.repo_id) == (scale == "paper")
    assert config.dataset.eval_split == 0.1 and not config.policy.push_to_hub
    if scale == "cpu":
        assert config.steps <= 15_000
    else:
        check_papers_sizes(config, kind)


def check_papers_sizes(config: TrainPipelineConfig, kind: str) -> None:
    sizes = (ALIGN if kind == "align_flow" else FLOW) | MODEL | TRAINING
    if config.policy.type != "csa_assist":  # it always knows its context
        sizes["context_dropout"] = 0.2
    assert {name: getattr(config.policy, name) for name in sizes} == sizes
    assert config.policy.pretrained_backbone_weights == "ResNet18_Weights.IMAGENET1K_V1"
    assert (config.batch_size, config.policy.samples_per_item) == (256, 1)
