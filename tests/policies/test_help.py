import dataclasses
import importlib

import pytest
from draccus.wrappers.docstring import get_attribute_docstring, get_preferred_help_text
from lerobot.configs import PreTrainedConfig, parser
from lerobot.configs.eval import EvalPipelineConfig
from lerobot.envs import EnvConfig

from lerobot_gloves.commands import COMMANDS, assisting
from lerobot_gloves.perturbations import CHOICES
from lerobot_policy_gloves.gloves.configuration_gloves import PerturbationConfig

POLICIES = ["gloves", "gloves_expert_flow", "gloves_flow_policy", "gloves_align_flow", "ddpm_assist", "csa_assist"]
TASKS = ["gloves_slalom", "gloves_keypad", "gloves_can", "gloves_charger"]
LEROBOTS = {field.name for field in dataclasses.fields(EnvConfig)} - {"task", "fps"}


def unexplained(config: type, inherited: set[str] = frozenset()) -> list[str]:
    """Options of a configuration that have no text in the help."""
    own = [field.name for field in dataclasses.fields(config) if field.name not in inherited]
    assert own
    texts = {name: get_preferred_help_text(get_attribute_docstring(config, name)) for name in own}
    # What draccus takes for a field's comment may be the code below it.
    return [name for name, text in texts.items() if not text or "def " in text]


@pytest.mark.parametrize("kind", POLICIES)
def test_every_option_of_a_policy_is_explained(kind):
    inherited = {field.name for field in dataclasses.fields(PreTrainedConfig)}
    assert unexplained(PreTrainedConfig.get_choice_class(kind), inherited) == []


@pytest.mark.parametrize("task", TASKS)
def test_every_option_of_a_task_is_explained(task):
    assert unexplained(EnvConfig.get_choice_class(task), LEROBOTS) == []


@pytest.mark.parametrize("name", CHOICES)
def test_every_option_of_a_perturbation_is_explained(name):
    assert unexplained(PerturbationConfig.get_choice_class(name)) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_of_our_commands_is_explained(command):
    module = importlib.import_module(f"lerobot_gloves.commands.{command}")
    own = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and dataclasses.is_dataclass(value)
        and value.__module__ in (module.__name__, assisting.__name__)
    ]
    assert own
    for config in own:
        lerobots = [base for base in config.__mro__[1:] if base.__module__.partition(".")[0] == "lerobot"]
        inherited = {field.name for base in lerobots for field in dataclasses.fields(base)}
        assert unexplained(config, inherited) == [], config.__name__


def test_lerobots_help_prints_them(typed, capsys):
    @parser.wrap()
    def command(cfg: EvalPipelineConfig) -> None: ...

    typed("--policy.type=gloves", "--policy.perturbation.type=shift", "--env.type=gloves_keypad", "--help")
    with pytest.raises(SystemExit):
        command()
    printed = " ".join(capsys.readouterr().out.split())
    for option, text in (
        ("--policy.perturbation.alpha float", "What is added, in raw action units."),
        ("--policy.perturbation.dim int", "The action dimension, d."),
        ("--env.episode str", "What an episode is: code, three presses, or press, a single one."),
        ("--env.obs_type str", "What policies observe: state, or pixels_agent_pos,"),
        ("--env.episode_length int", "Control steps until a timeout."),
    ):
        assert f"{option} {text}" in printed, option
