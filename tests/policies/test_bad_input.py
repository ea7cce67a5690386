"""Whatever is wrong is named in one line, before anything moves."""

import shutil

import pytest
import torch
from draccus.utils import ParsingError
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies import make_policy_config
from safetensors.torch import load_file, save_file

from lerobot_gloves.checkpoints.calibration import CALIBRATION_NAME
from lerobot_policy_gloves.gloves.finite import NonFiniteProposalError
from lerobot_policy_gloves.gloves.modeling_gloves import GlovesPolicy
from tests.builders import CAMERA, calibrate, features, observation, save_policy, wrap


def one_line(error) -> str:
    text = str(error.value)
    assert "\n" not in text.strip()
    return text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fegg"}, "unknown method 'fegg': choose from feeg, fpas, ifae, none"),
        ({"method": "feeg:begin=1"}, "method 'feeg' has no option 'begin': choose from start, steps, align"),
        ({"score": "revers"}, "unknown score 'revers': choose from likelihood, residual, reverse, selfnormalised"),
        ({"gate": True, "alpha": 1.5}, "alpha is 1.5, but must lie in [0, 1]"),
        (
            {"gate": True, "score": "reverse:steps=3"},
            "not calibrated for score 'reverse:steps=3', only for reverse:steps=1",
        ),
    ],
)
def test_wrong_words_are_named_with_the_right_ones(checkpoints, options, message):
    with pytest.raises(ValueError) as error:
        wrap(checkpoints.agent, adapter=checkpoints.adapter, **options)
    assert message in one_line(error)


@pytest.mark.parametrize("options", [{"gate": True}, {"method": "feeg"}, {"method": "fegg"}])
def test_correction_without_an_adapter_is_refused(checkpoints, options):
    with pytest.raises(ValueError, match=r"need --policy\.adapter") as error:
        wrap(checkpoints.agent, **options)
    one_line(error)


def test_a_wrapper_without_an_agent_says_how_to_name_one():
    with pytest.raises(ValueError, match=r"--policy\.path=AGENT --policy\.wrap=gloves, or by --policy\.agent=AGENT"):
        GlovesPolicy(make_policy_config("gloves"))


def test_an_unknown_wrapper_is_refused(checkpoints, parse_eval):
    with pytest.raises(SystemExit, match=r"^unknown --policy\.wrap=glovs: the only wrapper is gloves$"):
        parse_eval(f"--policy.path={checkpoints.agent}", "--policy.wrap=glovs")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--policy.method=feeg", r"--policy\.method and --policy\.gate need --policy\.adapter, a trained checkpoint"),
        ("--policy.adapter=", r"gloves: --policy\.adapter is empty"),
        ("--policy.seed=-1", "gloves: seed is -1, but must not be negative"),
        (
            "--policy.agent_overrides=[",
            r"gloves: --policy\.agent_overrides=\[ is no list of options: write \[--name=value\]",
        ),
        ("--policy.agent_overrides=--seed=8", r"gloves: --policy\.agent_overrides=--seed=8 is no list of options"),
        ("--policy.adaptor=x", "unrecognized arguments: --adaptor=x: choose from .*--chunk_size.*own, --adapter, "),
    ],
)
def test_a_wrong_option_beside_wrap_is_one_clear_line(checkpoints, parse_eval, option, message):
    """Not the parser's "couldn't instantiate" at the end of its traceback."""
    with pytest.raises(SystemExit, match=message) as exit:
        parse_eval(f"--policy.path={checkpoints.agent}", "--policy.wrap=gloves", option)
    assert "\n" not in str(exit.value.code)


def test_a_wrapper_is_not_wrapped(checkpoints, parse_eval, tmp_path):
    wrap(checkpoints.agent).save_pretrained(tmp_path)
    with pytest.raises(SystemExit, match=f"{tmp_path} is a gloves wrapper already: leave out --policy.wrap"):
        parse_eval(f"--policy.path={tmp_path}", "--policy.wrap=gloves")


@pytest.mark.parametrize("form", ["--policy.path={} --policy.wrap=gloves", "--policy.type=gloves --policy.agent={}"])
def test_an_unknown_perturbation_is_refused_with_the_valid_ones(checkpoints, parse_eval, capsys, form):
    with pytest.raises(SystemExit) as exit:
        parse_eval(*form.format(checkpoints.agent).split(), "--policy.perturbation.type=noisy")
    assert exit.value.code == 2
    *_, last = capsys.readouterr().err.strip().splitlines()
    assert "'noisy'" in last and all(name in last for name in ("noised", "laggy", "slow", "shift"))


def test_a_wrong_part_of_a_compound_is_one_clear_line(checkpoints, parse_eval):
    options = ["--policy.perturbation.type=compound", "--policy.perturbation.parts=noised+lagy"]
    with pytest.raises(SystemExit, match=r"^gloves: unknown perturbation 'lagy': choose from .*laggy, ") as exit:
        parse_eval(f"--policy.path={checkpoints.agent}", "--policy.wrap=gloves", *options)
    assert "\n" not in str(exit.value.code)


def test_an_unknown_observation_type_is_refused_with_the_valid_ones(checkpoints, parse_eval):
    with pytest.raises(ParsingError) as error:
        parse_eval(f"--policy.path={checkpoints.agent}", "--env.obs_type=pixel")
    assert str(error.value.__cause__) == "Slalom has no obs_type 'pixel': choose one of state, pixels_agent_pos"


def test_an_adapter_of_other_actions_is_refused(checkpoints, tmp_path):
    other = {"action": PolicyFeature(FeatureType.ACTION, (7,))}
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", output_features=other)
    with pytest.raises(ValueError, match=r"the adapter needs action \(7,\), but the agent has action \(2,\)") as error:
        wrap(checkpoints.agent, adapter=adapter)
    one_line(error)


def test_an_adapter_of_other_cameras_is_refused(checkpoints, tmp_path):
    inputs, outputs = features("pixels_agent_pos")
    wrist = {("observation.images.wrist" if key == CAMERA else key): value for key, value in inputs.items()}
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", input_features=wrist, output_features=outputs)
    with pytest.raises(ValueError) as error:
        wrap(checkpoints.agent, adapter=adapter)
    needs = "the adapter needs observation.images.wrist (3, 64, 64), but the agent has observation."
    assert f"{needs}environment_state (12,), " in one_line(error)
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", "pixels_agent_pos")
    with pytest.raises(ValueError) as error:
        wrap(agent, adapter=adapter)
    assert f"{needs}goal (9,), observation.images.front (3, 64, 64), " in one_line(error)
    wrap(agent, adapter=adapter, adapter_rename_map={CAMERA: "observation.images.wrist"})


def test_an_adapter_of_another_state_is_refused(checkpoints, tmp_path):
    inputs, outputs = features()
    inputs["observation.state"] = PolicyFeature(FeatureType.STATE, (6,))
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", input_features=inputs, output_features=outputs)
    with pytest.raises(
        ValueError, match=r"needs observation\.state \(6,\), but the agent has .*observation\.state \(4,\)"
    ) as error:
        wrap(checkpoints.agent, adapter=adapter)
    one_line(error)


def test_an_observation_that_only_the_adapter_needs_and_nobody_gives_is_named(checkpoints):
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter)
    batch = observation(2)
    policy._corrector.rename_map = {"observation.state": "observation.pose"}
    with pytest.raises(
        ValueError, match=r"the adapter needs observation\.state, but is given only .*observation\.pose"
    ) as error:
        policy.select_action(batch)
    assert "--policy.adapter_rename_map" in one_line(error)


def test_a_key_to_rename_that_nobody_gives_is_named(checkpoints):
    policy = wrap(checkpoints.agent, adapter=checkpoints.adapter, adapter_rename_map={"observation.stat": "x"})
    with pytest.raises(ValueError, match=r"renames observation\.stat, but there is only .*observation\.state"):
        policy.select_action(observation(2))


def test_a_policy_that_corrects_nothing_is_no_adapter(checkpoints, tmp_path):
    with pytest.raises(ValueError, match="is a policy of type 'act', which cannot correct another one") as error:
        wrap(checkpoints.agent, adapter=save_policy(tmp_path / "act", "act"))
    assert "gloves_expert_flow" in one_line(error)


def test_a_gate_without_a_calibration_says_how_to_make_one(checkpoints, tmp_path):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow")
    with pytest.raises(ValueError, match=f"the gate needs a calibration, and {adapter} has none: run gloves calibrate"):
        wrap(checkpoints.agent, adapter=adapter, gate=True)
    wrap(checkpoints.agent, adapter=adapter)  # FEEG without a gate needs none


def test_fpas_without_a_calibration_says_at_loading_how_to_make_one(checkpoints, tmp_path):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow")
    with pytest.raises(
        ValueError, match=f"fpas needs a calibration, and {adapter} has none: run gloves calibrate"
    ) as error:
        wrap(checkpoints.agent, adapter=adapter, method="fpas:sigma=0.2")
    one_line(error)
    with pytest.raises(ValueError, match="not calibrated for score 'reverse:steps=3', only for reverse:steps=1"):
        wrap(checkpoints.agent, adapter=checkpoints.adapter, method="fpas", score="reverse:steps=3")
    wrap(checkpoints.agent, adapter=checkpoints.adapter, method="fpas").select_action(observation(2))  # no gate needed


def test_a_gate_that_could_turn_nothing_away_is_refused(checkpoints, tmp_path):
    """The least p-value of 98 scores is 1 / 99; `alpha=0` asks for it."""
    adapter = calibrate(
        save_policy(tmp_path / "adapter", "gloves_expert_flow"), scores={"reverse:steps=1": torch.rand(6, 98)}
    )
    with pytest.raises(ValueError, match=r"alpha is 0\.01, but with 98 calibration .* on at least 99 chunks") as error:
        wrap(checkpoints.agent, adapter=adapter, gate=True, alpha=0.01)
    one_line(error)
    for alpha in (0.0, 1 / 99):
        wrap(checkpoints.agent, adapter=adapter, gate=True, alpha=alpha)


def test_a_calibration_at_another_guidance_is_refused(checkpoints):
    guided = {"adapter": checkpoints.adapter, "adapter_overrides": ["--guidance=2"]}
    with pytest.raises(ValueError, match=r"guidance is 2, but .* with 1: run gloves calibrate --policy\.guidance=2"):
        wrap(checkpoints.agent, **guided, gate=True)
    wrap(checkpoints.agent, **guided).select_action(observation(2))  # no gate that could go wrong


@pytest.mark.parametrize("gate", [True, False])
def test_a_calibration_of_other_weights_is_refused(checkpoints, tmp_path, gate):
    adapter = calibrate(save_policy(tmp_path / "adapter", "gloves_expert_flow"))
    weights = load_file(adapter / "model.safetensors")
    weights["ema.module.dit.head.bias"] += 1e-6
    save_file(weights, adapter / "model.safetensors")
    with pytest.raises(
        ValueError, match=r"the calibration belongs to other weights .* run gloves calibrate again"
    ) as error:
        wrap(checkpoints.agent, adapter=adapter, gate=gate)
    one_line(error)


def test_an_unreadable_calibration_is_named(checkpoints, tmp_path):
    adapter = calibrate(save_policy(tmp_path / "adapter", "gloves_expert_flow"))
    path = adapter / CALIBRATION_NAME
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(ValueError, match=f"{CALIBRATION_NAME} of {adapter} is not a readable calibration") as error:
        wrap(checkpoints.agent, adapter=adapter, gate=True)
    one_line(error)


def test_damaged_weights_of_the_adapter_are_named(checkpoints, tmp_path):
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow")
    path = adapter / "model.safetensors"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match=f"{path} is not a readable safetensors file"):
        wrap(checkpoints.agent, adapter=adapter)


@pytest.mark.parametrize("part", ["preprocessor", "postprocessor"])
@pytest.mark.parametrize("broken", ["agent", "adapter"])
def test_damaged_processors_are_named(checkpoints, tmp_path, broken, part):
    paths = {"agent": checkpoints.agent, "adapter": checkpoints.adapter}
    shutil.copytree(paths[broken], tmp_path / "broken")
    paths[broken] = tmp_path / "broken"
    [path] = paths[broken].glob(f"policy_{part}_step_*.safetensors")
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match=f"{path} is not a readable safetensors file: .*") as error:
        wrap(**paths)
    one_line(error)


@pytest.mark.parametrize("folder", ["agent", "adapter"])
def test_a_missing_checkpoint_is_named(checkpoints, tmp_path, folder):
    (tmp_path / "empty").mkdir()
    paths = {"agent": checkpoints.agent, "adapter": checkpoints.adapter, folder: tmp_path / "empty"}
    named = f"^--policy.{folder}={tmp_path / 'empty'} is no checkpoint's folder, nor one on the Hub in reach$"
    with pytest.raises(ValueError, match=named):
        wrap(**paths)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_proposal_that_is_not_finite_is_never_executed(checkpoints, value):
    policy, batch = wrap(checkpoints.agent, adapter=checkpoints.adapter), observation(3)
    for _ in range(5):
        assert policy.select_action(batch).isfinite().all()
    head = policy._agent.policy.model.action_head

    def spoil(module, inputs, output):
        output[1, 2, 0] = value
        return output

    head.register_forward_hook(spoil)
    with pytest.raises(
        NonFiniteProposalError, match="the agent proposed a non-finite action in environment 1 at step 5"
    ) as error:
        policy.select_action(batch)
    assert ("nan" if value != value else "inf") in one_line(error)


def test_without_an_adapter_too(checkpoints):
    policy = wrap(checkpoints.agent)
    policy._agent.policy.model.action_head.bias.data.fill_(float("nan"))
    with pytest.raises(NonFiniteProposalError, match="environment 0 at step 0"):
        policy.select_action(observation(2))


def test_an_edit_that_is_not_finite_is_never_executed(checkpoints, tmp_path):
    inputs, outputs = features()
    blind = {key: value for key, value in inputs.items() if key != "observation.environment_state"}
    agent = save_policy(tmp_path / "agent", "gloves_flow_policy", input_features=blind, output_features=outputs)
    policy = wrap(agent, adapter=checkpoints.adapter, gate=True)
    batch = observation(2)
    batch["observation.environment_state"][1] = float("nan")
    with pytest.raises(
        NonFiniteProposalError, match="the editor returned a non-finite action in environment 1 at step 0"
    ):
        policy.select_action(batch)
