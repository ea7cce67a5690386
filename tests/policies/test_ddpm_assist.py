"""The baseline `ddpm_assist` as a LeRobot policy and as an adapter."""

import sys

import pytest
import torch
from lerobot.policies import get_policy_class, make_policy_config
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.scripts.lerobot_train import train
from safetensors.torch import load_file, save_file

from lerobot_gloves.adapter import Adapter
from lerobot_policy_ddpm_assist.diffusion import Diffusion, noise_prediction_loss, noise_scheduler
from lerobot_policy_ddpm_assist.editor import DDPM
from tests.builders import CAMERA, FLOW, awaken, features, observation, save_policy, wrap, write_dataset
from tests.gaussian import seeded

SMALL = {key: value for key, value in FLOW.items() if key != "num_inference_steps"}
WITHOUT_DIFFUSERS = 'ddpm_assist needs diffusers, of the extra ddpm: pip install "lerobot_policy_gloves[ddpm]"'


def make_assist(obs_type: str = "state", *, seed: int = 0, **options: object) -> PreTrainedPolicy:
    """A tiny policy, every weight of which matters."""
    inputs, outputs = features(obs_type)
    made = {"input_features": inputs, "output_features": outputs, "device": "cpu", "push_to_hub": False}
    config = make_policy_config("ddpm_assist", **{**made, **SMALL, **options})
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        policy = get_policy_class("ddpm_assist")(config)
        awaken(policy)
    return policy.eval()


def test_training_teaches_the_expert():
    torch.manual_seed(0)
    options = {"width": 32, "dropout": 0.0, "context_dropout": 0.0, "ema_decay": 0.9, "optimizer_lr": 5e-3}
    policy = make_assist(**options)
    along = torch.linspace(-1, 1, 6)[:, None]
    observed = [observation(64, seed=seed) for seed in (0, 1)]
    data, held_out = ({**seen, "action": seen["observation.state"][:, None, :2] + along} for seen in observed)
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())

    def error() -> float:
        return (policy.predict_action_chunk(held_out) - held_out["action"]).square().mean().item()

    for _ in range(200):
        loss, _ = policy.train()(data)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
    assert error() < 0.25 * held_out["action"].var()
    wrong = held_out["action"] + 0.5
    bound = policy.bind(held_out)
    edited = bound.edit(wrong, DDPM(0.4), generator=seeded(0))
    distance = {name: (c - held_out["action"]).square().mean() for name, c in [("edited", edited), ("wrong", wrong)]}
    assert distance["edited"] < 0.6 * distance["wrong"]


def test_the_loss_and_the_samples_are_the_networks():
    policy, data, told = make_assist(num_train_steps=8, samples_per_item=3), observation(2), []
    data["action"] = torch.randn(2, 6, 2, generator=seeded(0))
    diffusion = Diffusion(policy.ema.module.bind(data), noise_scheduler("sigmoid", 8, 1e-4, 0.26))
    torch.manual_seed(0)
    expected = noise_prediction_loss(diffusion, data["action"], samples=3)
    torch.manual_seed(0)
    assert torch.equal(policy(data, reduction="none")[0], expected)
    policy.ema.module.dit.register_forward_pre_hook(lambda module, inputs: told.append(inputs[1].tolist()))
    policy.predict_action_chunk(data)
    assert told == [[k / 8] * 2 for k in range(8)]  # all steps, from noise at t = 0


def test_it_is_an_adapter_that_counts_evaluations_and_edits_rows_alike_in_any_batch():
    policy, data = make_assist(), observation(3)
    assert isinstance(policy, Adapter) and policy.scores == {}
    chunk = torch.randn(3, 6, 2, generator=seeded(0))
    with torch.inference_mode():
        bound = policy.bind(data)
        editor = policy.editors["ddpm"](gamma=0.4)
        assert editor == DDPM()
        edited = bound.edit(chunk, editor, generator=[seeded(i) for i in range(3)])
        again = bound.edit(chunk, editor, generator=[seeded(i) for i in range(3)])
        some = bound.select(torch.tensor([True, False, True]))
        part = some.edit(chunk[::2], editor, length=4, generator=[seeded(0), seeded(2)])
    assert torch.equal(edited, again)
    torch.testing.assert_close(part, edited[::2], rtol=1e-5, atol=1e-5)
    assert (bound.evaluations, some.evaluations) == (38, 19)


def test_the_wrapper_edits_every_proposal_by_it(tmp_path):
    agent = save_policy(tmp_path / "agent", "act")
    adapter = save_policy(tmp_path / "assist", "ddpm_assist", policy=make_assist())
    wrappers = [wrap(agent), wrap(agent, adapter=adapter, method="ddpm:gamma=0"), wrap(agent, adapter=adapter)]
    raw, kept, edited = (wrapper.predict_action_chunk(observation(2)) for wrapper in wrappers)
    torch.testing.assert_close(kept, raw, rtol=1e-4, atol=1e-7)  # there and back through the adapter's units
    assert (edited - raw).abs().amax(dim=(1, 2)).min() > 1e-4
    corrections = [wrapper.correction for wrapper in wrappers[1:]]
    assert [c.evaluations.tolist() for c in corrections] == [[0, 0], [19, 19]]
    assert all(c.score is None and c.edited.all() for c in corrections)


def test_an_edit_follows_the_observation_and_never_the_goal():
    policy, data, chunk = make_assist(), observation(2), torch.randn(2, 6, 2, generator=seeded(0))
    edits = {}
    for key in ("", *data):
        changed = {**data, key: data[key] + 1} if key else data
        bound = policy.bind(
            {name: changed[name] for name in changed if key == "observation.goal" or "goal" not in name}
        )
        edits[key] = bound.edit(chunk, DDPM(), generator=seeded(0))
    assert [torch.equal(edits[key], edits[""]) for key in data] == ["goal" in key for key in data]
    assert "observation.goal" not in policy.config.input_features


def test_images_are_a_context_too():
    policy = make_assist("pixels_agent_pos")
    data = {key: value for key, value in observation(2, "pixels_agent_pos").items() if "goal" not in key}
    dark = {**data, CAMERA: torch.zeros_like(data[CAMERA])}
    chunks = []
    for batch in (data, dark):
        policy.reset()
        policy._episodes._next = 0
        chunks.append(policy.predict_action_chunk(batch))
    assert chunks[0].shape == (2, 6, 2) and not torch.allclose(*chunks)


def test_a_chunks_draws_belong_to_its_episode():
    rows = {key: value[:1].expand(4, *value.shape[1:]) for key, value in observation(1).items()}
    together = make_assist().predict_action_chunk(rows)
    again, pairs = make_assist(), []
    for _ in range(2):
        again.reset()
        pairs.append(again.predict_action_chunk({key: value[:2] for key, value in rows.items()}))
    torch.testing.assert_close(torch.cat(pairs), together, rtol=1e-4, atol=1e-5)
    distances = torch.cdist(together.flatten(1), together.flatten(1))
    assert distances[~torch.eye(4, dtype=torch.bool)].min() > 0.1


def test_a_checkpoint_comes_back_bit_for_bit_and_the_average_alone_acts_alike(tmp_path):
    policy, data = make_assist(schedule="linear", beta_max=0.1, num_train_steps=20), observation(2)
    with torch.no_grad():
        policy.network.dit.head.bias.add_(0.1)
    folder = save_policy(tmp_path / "assist", "ddpm_assist", policy=policy)
    chunk = policy.predict_action_chunk(data)
    again = get_policy_class("ddpm_assist").from_pretrained(folder)
    assert all(torch.equal(value, again.state_dict()[key]) for key, value in policy.state_dict().items())
    assert torch.equal(again.scheduler.betas, torch.linspace(1e-4, 0.1, 20))
    assert torch.equal(again.predict_action_chunk(data), chunk)
    weights = {k: v for k, v in load_file(folder / "model.safetensors").items() if not k.startswith("network.")}
    save_file(weights, folder / "model.safetensors")
    slim = get_policy_class("ddpm_assist").from_pretrained(folder)
    assert torch.equal(slim.predict_action_chunk(data), chunk)


def test_it_trains_and_resumes_by_lerobots_command(tmp_path, typed):
    write_dataset(tmp_path / "data")
    output = tmp_path / "run"
    typed(
        "--policy.type=ddpm_assist",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        *(f"--policy.{key}={value}" for key, value in SMALL.items() if value is not None),
        "--policy.num_train_steps=10",
        "--dataset.repo_id=me/tiny",
        f"--dataset.root={tmp_path / 'data'}",
        "--dataset.eval_split=0.25",
        "--batch_size=4",
        "--num_workers=0",
        "--steps=2",
        "--eval_steps=2",
        f"--output_dir={output}",
    )
    train()
    last = output / "checkpoints" / "last" / "pretrained_model"
    first = load_file(last / "model.safetensors")
    assert first["ema.n_averaged"] == 2
    typed(f"--config_path={last / 'train_config.json'}", "--resume=true", "--steps=5")
    train()
    resumed = get_policy_class("ddpm_assist").from_pretrained(last)
    assert resumed.state_dict()["ema.n_averaged"] == 5
    assert not torch.equal(resumed.state_dict()["network.dit.head.bias"], first["network.dit.head.bias"])
    assert set(resumed.config.input_features) == {"observation.state", "observation.environment_state"}
    assert resumed.config.num_train_steps == len(resumed.scheduler.betas) == 10
    assert resumed.predict_action_chunk(observation(2)).isfinite().all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"schedule": "cosine"}, "has no schedule 'cosine': choose from sigmoid, linear, squaredcos_cap_v2"),
        ({"num_train_steps": 1}, "num_train_steps is 1, but must be at least 2"),
        ({"beta_min": 0.0}, "beta_min is 0.0 and beta_max is 0.26, but 0 < beta_min <= beta_max < 1 must hold"),
        ({"beta_max": 1.0}, "beta_min is 0.0001 and beta_max is 1.0, but"),
        ({"beta_min": 0.3}, "beta_min is 0.3 and beta_max is 0.26, but"),
        ({"num_inference_steps": 10}, "num_inference_steps is 10, but sampling takes all num_train_steps, 50"),
    ],
)
def test_impossible_options_are_one_clear_line(options, message):
    with pytest.raises(ValueError) as error:
        make_policy_config("ddpm_assist", **options)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_without_diffusers_the_policy_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "diffusers", None)
    with pytest.raises(ImportError) as error:
        make_assist()
    assert str(error.value) == WITHOUT_DIFFUSERS
