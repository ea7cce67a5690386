"""The three ways to wrap an agent in LeRobot's own commands."""

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from lerobot.policies import make_policy_config
from lerobot.scripts.lerobot_eval import eval_main

from lerobot_gloves.perturbations import Compound, Laggy, Noised, Shift, written_out
from lerobot_policy_gloves.gloves.configuration_gloves import PASSTHROUGH, GlovesConfig
from lerobot_policy_gloves.gloves.modeling_gloves import GlovesPolicy
from tests.builders import features, load, observation, save_policy, wrap
from tests.preloaded import server

RUN = [
    "--env.type=gloves_slalom",
    "--env.episode_length=9",
    "--env.image_size=64",
    "--eval.n_episodes=3",
    "--eval.batch_size=2",
    "--eval.use_async_envs=false",
    "--seed=10000",
]
CORRECTION = {"method": "feeg:steps=2", "gate": "true", "alpha": "0.2", "seed": "4"}


@pytest.fixture(scope="module")
def checkpoints(checkpoints, tmp_path_factory):
    """With an agent that acts otherwise in every episode."""
    agent = save_policy(tmp_path_factory.mktemp("flow") / "agent", "gloves_flow_policy", n_action_steps=5)
    return dataclasses.replace(checkpoints, agent=agent)


def form(name: str, checkpoints, folder: Path) -> list[str]:
    """Options of one form; what they say is the same."""
    options = {**CORRECTION, "adapter": str(checkpoints.adapter)}
    overrides = {"n_action_steps": "3"}
    if name == "wrap":
        options |= {"path": str(checkpoints.agent), "wrap": "gloves", **overrides}
    else:
        given = json.dumps([f"--{key}={value}" for key, value in overrides.items()])
        options |= {"type": "gloves", "agent": str(checkpoints.agent), "agent_overrides": given}
    if name == "saved":
        kinds = {"gate": True, "alpha": 0.2, "seed": 4, "agent_overrides": json.loads(options["agent_overrides"])}
        config = make_policy_config("gloves", **{key: v for key, v in options.items() if key != "type"} | kinds)
        GlovesPolicy(config).save_pretrained(folder / "wrapper")
        options = {"path": str(folder / "wrapper")}
    return [f"--policy.{key}={value}" for key, value in options.items()]


def journal(path: Path) -> list[dict]:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return [{key: value for key, value in line.items() if key != "milliseconds"} for line in lines]


@pytest.fixture(scope="module")
def reference(checkpoints, tmp_path_factory):
    """What the wrapper does in those episodes, without LeRobot's command line."""
    folder = tmp_path_factory.mktemp("reference")
    patch = pytest.MonkeyPatch()
    patch.setattr(sys, "argv", ["lerobot-eval", *RUN, *form("wrap", checkpoints, folder), *outputs(folder)])
    eval_main()
    patch.undo()
    lines = journal(folder / "log.jsonl")
    # n_action_steps reached the agent: nine steps are three decisions, each of all that is proposed.
    assert [line["episode"] for line in lines] == [0, 1] * 3 + [2, 3] * 3
    assert {line["length"] for line in lines} == {6}
    assert len({line["score"] for line in lines}) == len(lines)
    return lines


def outputs(folder: Path) -> list[str]:
    return [f"--policy.log={folder / 'log.jsonl'}", f"--output_dir={folder / 'eval'}"]


@pytest.mark.parametrize("name", ["type", "saved"])
def test_the_forms_do_the_same_in_lerobot_eval(checkpoints, tmp_path, typed, reference, name):
    typed(*RUN, *form(name, checkpoints, tmp_path), *outputs(tmp_path))
    eval_main()
    assert journal(tmp_path / "log.jsonl") == reference
    assert json.loads((tmp_path / "eval" / "eval_info.json").read_text())["overall"]["n_episodes"] == 3


@pytest.mark.slow
def test_the_command_itself(checkpoints, tmp_path, reference):
    command = [server() / "lerobot-eval", *RUN, *form("wrap", checkpoints, tmp_path)]
    result = subprocess.run([*command, *outputs(tmp_path)], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr[-3000:]
    assert journal(tmp_path / "log.jsonl") == reference
    edited = sum(line["edited"] for line in reference) / len(reference)
    assert f"gloves: {len(reference)} chunks, {100 * edited:.1f} % edited, " in result.stderr + result.stdout


@pytest.mark.parametrize(
    "path",
    ["{agent}", "{agent}/", "{agent}/."],
)
def test_the_agents_folder_may_be_written_in_any_way(checkpoints, parse_eval, monkeypatch, path):
    monkeypatch.chdir(checkpoints.agent.parent)
    for agent in (str(checkpoints.agent), f"./{checkpoints.agent.name}"):
        config = parse_eval(f"--policy.path={path.format(agent=agent)}", "--policy.wrap=gloves").policy
        assert isinstance(config, GlovesConfig)
        assert config.pretrained_path == PASSTHROUGH  # the agent's processors would normalise twice
        assert config.agent_config.type == "gloves_flow_policy"


def test_options_may_be_written_with_a_space(checkpoints, parse_eval):
    config = parse_eval(
        "--policy.path", str(checkpoints.agent), "--policy.wrap", "gloves", "--policy.adapter", str(checkpoints.adapter)
    ).policy
    assert (config.agent, config.adapter) == (str(checkpoints.agent), str(checkpoints.adapter))


def test_without_wrap_an_agent_is_itself(checkpoints, parse_eval):
    config = parse_eval(f"--policy.path={checkpoints.agent}", "--policy.n_action_steps=2").policy
    assert (config.type, config.n_action_steps, config.pretrained_path) == ("gloves_flow_policy", 2, checkpoints.agent)


@pytest.mark.parametrize("overrides", ['["--seed=8"]', "[--seed=8]"])
def test_the_wrappers_options_are_its_own_and_the_others_the_agents(checkpoints, parse_eval, overrides):
    config = parse_eval(
        f"--policy.path={checkpoints.agent}",
        "--policy.wrap=gloves",
        "--policy.seed=3",  # both have one
        f"--policy.agent_overrides={overrides}",
        "--policy.num_inference_steps=7",
        "--policy.pretrained_revision=v1",
        "--policy.use_amp=false",
        "--policy.device=cpu",
    ).policy
    assert (config.seed, config.agent_config.seed) == (3, 8)
    assert config.agent_config.num_inference_steps == 7
    assert config.num_inference_steps == 7  # LeRobot asks a policy's configuration for what only some have
    assert config.agent_revision == config.agent_config.pretrained_revision == "v1"
    with pytest.raises(AttributeError, match="no_such_option"):
        _ = config.no_such_option


def test_the_wrapper_is_asked_about_what_its_agent_needs(checkpoints):
    config = make_policy_config("gloves", agent=str(checkpoints.agent))
    assert config.input_features == config.agent_config.input_features
    assert config.action_feature.shape == (2,)
    assert (config.device, config.use_amp, config.n_obs_steps) == ("cpu", False, 1)


def test_the_device_asked_for_is_the_device(checkpoints, monkeypatch):
    """The agent's is where it was trained."""
    monkeypatch.setattr("lerobot.configs.policies.is_torch_device_available", lambda device: True)
    assert make_policy_config("gloves", agent=str(checkpoints.agent), device="mps").device == "mps"
    assert make_policy_config("gloves", agent=str(checkpoints.agent)).device == "cpu"


def test_a_saved_wrapper_is_complete(checkpoints, tmp_path):
    options = {
        "gate": True,
        "alpha": 0.3,
        "method": "feeg:start=0.25",
        "seed": 9,
        "perturbation": Shift(dim=0, alpha=0.001, p=0.5),
        "adapter_rename_map": {"observation.goal": "observation.aim"},
        "log": tmp_path / "log",
    }
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter, **options)
    policy.save_pretrained(tmp_path / "wrapper")
    again, _ = load(tmp_path / "wrapper")
    for key, value in options.items():
        saved = getattr(again.config, key)
        assert vars(saved) == vars(value) if key == "perturbation" else saved == value, key
    batch = observation(2)
    with torch.inference_mode():
        assert all(torch.equal(policy.select_action(batch), again.select_action(batch)) for _ in range(7))


def test_a_saved_wrapper_finds_its_checkpoints_from_anywhere(checkpoints, tmp_path, monkeypatch):
    for name in ("agent", "adapter"):
        shutil.copytree(getattr(checkpoints, name), tmp_path / name)
    monkeypatch.chdir(tmp_path)
    wrap(Path("agent"), adapter=Path("adapter")).save_pretrained("wrapper")
    monkeypatch.chdir("/")
    policy, _ = load(tmp_path / "wrapper")
    assert (policy.config.agent, policy.config.adapter) == (str(tmp_path / "agent"), str(tmp_path / "adapter"))
    assert json.loads((tmp_path / "wrapper" / "config.json").read_text())["pretrained_path"] is None


def test_a_compound_is_saved_and_acts_as_before(tmp_path):
    told = Compound("noised:sigma=0.02+delayed:steps=3+noised:sigma=0.1")
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", n_action_steps=6)  # executes all that it proposes
    policy = wrap(agent, perturbation=told, seed=4)
    policy.save_pretrained(tmp_path / "wrapper")
    saved = json.loads((tmp_path / "wrapper" / "config.json").read_text())
    assert saved["perturbation"] == {"type": "compound", "parts": told.parts}
    again, _ = load(tmp_path / "wrapper")
    plain, batch = wrap(agent), observation(2)
    played = [torch.stack([one.select_action(batch) for _ in range(24)], dim=1) for one in (policy, again, plain)]
    told.reset(2, seed=4)
    expected = torch.cat([told(chunk) for chunk in played[2].split(policy.config.n_action_steps, dim=1)], dim=1)
    assert torch.equal(played[0], expected) and torch.equal(played[1], expected)


def test_options_change_a_saved_wrapper(checkpoints, tmp_path):
    wrap(checkpoints.agent, adapter=checkpoints.adapter).save_pretrained(tmp_path / "wrapper")
    policy, _ = load(tmp_path / "wrapper", "--method=none", "--perturbation.type=noised", "--perturbation.sigma=0.02")
    assert policy.config.method == "none" and policy._corrector.editor is None
    assert isinstance(policy.config.perturbation, Noised) and policy.config.perturbation.sigma == 0.02


def test_observations_are_renamed_for_the_agent(tmp_path, checkpoints, typed):
    """`--rename_map` renames for the agent; the adapter has a map of its own, from the names after that."""
    names = {"observation.state": "observation.tip", "observation.environment_state": "observation.pillars"}
    inputs = {names.get(key, key): value for key, value in features()[0].items()}
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", input_features=inputs)
    wrapped = [
        f"--policy.path={agent}",
        "--policy.wrap=gloves",
        f"--policy.adapter={checkpoints.adapter}",
        f"--policy.adapter_rename_map={json.dumps({v: k for k, v in names.items()})}",
        f"--rename_map={json.dumps(names)}",
    ]
    typed(*RUN, *wrapped, *outputs(tmp_path))
    eval_main()
    assert [line["step"] for line in journal(tmp_path / "log.jsonl")] == [0, 0, 4, 4, 8, 8] * 2


@pytest.mark.parametrize("name", ["wrap", "type", "saved"])
def test_perturbations_are_chosen_on_the_command_line(checkpoints, tmp_path, parse_eval, name):
    options = ["--policy.perturbation.type=noised", "--policy.perturbation.sigma=0.02"]
    config = parse_eval(*form(name, checkpoints, tmp_path), *options).policy
    assert isinstance(config.perturbation, Noised)
    assert config.perturbation.sigma == 0.02
    assert parse_eval(*form(name, checkpoints, tmp_path)).policy.perturbation is None
    options = ["--policy.perturbation.type=compound", "--policy.perturbation.parts=noised:sigma=0.02+laggy:p=0.3"]
    config = parse_eval(*form(name, checkpoints, tmp_path), *options).policy
    assert isinstance(config.perturbation, Compound)
    assert written_out(config.perturbation) == "noised:sigma=0.02+laggy:p=0.3"


def test_a_perturbation_acts_on_the_agents_raw_chunks_in_each_episode_alike(checkpoints):
    batch = observation(3)
    bare, perturbed = wrap(checkpoints.agent), wrap(checkpoints.agent, perturbation=Shift(dim=1, alpha=0.5, p=1.0))
    chunk = torch.stack([bare.select_action(batch) for _ in range(5)], dim=1)
    shifted = torch.stack([perturbed.select_action(batch) for _ in range(5)], dim=1)
    torch.testing.assert_close(shifted, chunk + torch.tensor([0.0, 0.5]), rtol=0, atol=0)


def test_a_perturbation_draws_by_seed_and_episode(checkpoints):
    batch = {key: value[:1].expand(4, *value.shape[1:]) for key, value in observation(1).items()}

    def noise(batch_size: int, seed: int = 0) -> torch.Tensor:
        policy, drawn = wrap(checkpoints.agent, perturbation=Noised(sigma=1.0), seed=seed), []
        for _ in range(4 // batch_size):
            policy.reset()
            some = {key: value[:batch_size] for key, value in batch.items()}
            drawn.append(torch.stack([policy.select_action(some) for _ in range(7)], dim=1))
        return torch.cat(drawn)

    torch.testing.assert_close(noise(2), noise(4))
    assert torch.equal(noise(4), noise(4))
    assert not torch.allclose(noise(4, seed=1), noise(4), atol=0.1)
    assert not torch.allclose(noise(4)[0], noise(4)[1], atol=0.1)


def test_two_wrappers_of_one_configuration_draw_apart_and_leave_it_as_it_was(checkpoints, tmp_path):
    config = make_policy_config("gloves", agent=str(checkpoints.agent), perturbation=Laggy(p=0.5), seed=3)
    told = vars(config.perturbation).copy()
    pair, batches = [GlovesPolicy(config).eval() for _ in range(2)], [observation(2), observation(3, seed=1)]
    mixed = [[policy.select_action(batch) for policy, batch in zip(pair, batches, strict=True)] for _ in range(20)]
    for index, batch in enumerate(batches):
        alone = GlovesPolicy(config).eval()
        assert all(torch.equal(alone.select_action(batch), actions[index]) for actions in mixed)
    assert vars(config.perturbation) == told == {"p": 0.5}
    pair[0].save_pretrained(tmp_path / "wrapper")
    saved = json.loads((tmp_path / "wrapper" / "config.json").read_text())
    assert saved["perturbation"] == {"type": "laggy", "p": 0.5}
