"""The baseline `csa_assist` as two stages of a LeRobot policy, and its student as an adapter."""

from pathlib import Path

import pytest
import torch
from lerobot.policies import make_policy_config
from lerobot.policies.pretrained import PreTrainedPolicy
from safetensors.torch import load_file, save_file

from lerobot_gloves.adapter import Adapter
from lerobot_policy_csa_assist.editor import CSA
from lerobot_policy_csa_assist.edm import Denoiser, edm_loss, heun
from tests.builders import CAMERA, FLOW, observation, save_policy, wrap
from tests.policies.csa import data_of, load, make_csa, same, save_teacher

T = FLOW["chunk_size"]
LAST = Path("checkpoints") / "last"
WEIGHTS = "model.safetensors"


@pytest.fixture(scope="module")
def teacher(tmp_path_factory) -> Path:
    return save_teacher(tmp_path_factory.mktemp("teacher") / "teacher")


@pytest.fixture
def student(teacher) -> PreTrainedPolicy:
    return make_csa(stage="student", teacher=str(teacher))


# --- Stages ---


def test_a_student_starts_as_its_teachers_average_and_does_not_carry_it(teacher, student):
    weights = load_file(teacher / WEIGHTS)
    assert not torch.equal(weights["network.dit.head.bias"], weights["ema.module.dit.head.bias"])
    averaged = {key.removeprefix("ema.module."): value for key, value in weights.items() if key.startswith("ema.m")}
    assert same(student.network.state_dict(), averaged) and same(student.ema.module.state_dict(), averaged)
    assert student.state_dict().keys() == weights.keys()
    assert sum(p.numel() for p in student.parameters()) == 2 * sum(p.numel() for p in student.network.parameters())
    trained = {id(p) for group in student.get_optim_params() for p in group["params"]}
    assert trained == {id(p) for p in student.network.parameters()}


def test_a_saved_student_needs_no_teacher_until_it_learns(tmp_path):
    student = make_csa(stage="student", teacher=str(save_teacher(tmp_path / "teacher")))
    with torch.no_grad():
        student.network.dit.head.bias.add_(0.1)
    save_policy(tmp_path / "student", "csa_assist", policy=student)
    (tmp_path / "teacher").rename(tmp_path / "moved")
    loaded = load(tmp_path / "student")
    assert same(loaded.state_dict(), student.state_dict())
    assert same(load_file(tmp_path / "student" / WEIGHTS), student.state_dict())
    data = data_of(2)
    assert torch.equal(loaded.predict_action_chunk(data), student.predict_action_chunk(data))
    assert loaded.bind(data).edit(data["action"], CSA()).isfinite().all()
    with pytest.raises(ValueError, match=f"--policy.teacher={tmp_path / 'teacher'} is no checkpoint's folder") as error:
        loaded.train()(data)
    assert "\n" not in str(error.value)
    (tmp_path / "moved").rename(tmp_path / "teacher")
    state = torch.get_rng_state()
    assert same(loaded.teacher.state_dict(), student.teacher.state_dict())
    assert torch.equal(torch.get_rng_state(), state)  # a resumed run goes on with its own draws
    assert loaded.state_dict().keys() == student.state_dict().keys()


def test_the_average_alone_is_a_complete_student_and_a_complete_teacher(tmp_path):
    folder, data = save_teacher(tmp_path / "teacher"), data_of(3)
    before = make_csa(stage="student", teacher=str(folder))
    save_policy(tmp_path / "student", "csa_assist", policy=before)
    for path in (folder / WEIGHTS, tmp_path / "student" / WEIGHTS):
        save_file({key: value for key, value in load_file(path).items() if not key.startswith("network.")}, path)
    assert same(make_csa(stage="student", teacher=str(folder)).state_dict(), before.state_dict())
    edits = [policy.bind(data).edit(data["action"], CSA(30)) for policy in (before, load(tmp_path / "student"))]
    assert torch.equal(*edits)


# --- Losses ---


def test_the_teachers_loss_is_edms(teacher):
    policy, data = load(teacher), data_of(4)
    policy.config.samples_per_item, policy.config.p_mean, policy.config.p_std = 3, -0.5, 0.9
    data["action_is_pad"] = torch.zeros(4, T, dtype=torch.bool)
    data["action_is_pad"][1, 2:] = True
    for training, network in [(False, policy.ema.module), (True, policy.network)]:
        policy.train(training)
        policy.network.eval()  # without its dropout
        torch.manual_seed(1)
        loss, _ = policy(data, reduction="none")
        torch.manual_seed(1)
        denoiser = Denoiser(network.bind(data), policy.config.noise)
        expected = edm_loss(denoiser, data["action"], p_mean=-0.5, p_std=0.9, mask=~data["action_is_pad"], samples=3)
        torch.testing.assert_close(loss, expected, rtol=0, atol=0)


def test_the_students_loss_aims_at_the_average_one_step_of_the_teacher_further(teacher, student):
    data, noise = data_of(4), student.config.noise
    data["action_is_pad"] = torch.zeros(4, T, dtype=torch.bool)
    data["action_is_pad"][1, 2:] = True
    with torch.no_grad():  # three different networks
        student.network.dit.head.bias.add_(0.1)
        student.ema.module.dit.head.bias.sub_(0.1)
    student.train()
    student.network.eval()
    torch.manual_seed(1)
    loss, _ = student(data, reduction="none")
    torch.manual_seed(1)
    level = torch.randint(79, (4 * 8,))
    grid = noise.grid(like=loss)
    clean = data["action"].repeat_interleave(8, dim=0)
    noisy = clean + grid[level][:, None, None] * torch.randn(clean.shape)
    field, boundary = load(teacher).ema.module.bind(data), noise.sigma_min
    less = heun(Denoiser(field, noise), noisy, grid[level], grid[level + 1])
    aim = Denoiser(student.ema.module.bind(data), noise, boundary)(less, grid[level + 1])
    error = (Denoiser(student.network.bind(data), noise, boundary)(noisy, grid[level]) - aim).square().mean(-1)
    error = error.view(4, 8, T).mean(1)
    expected = torch.stack([error[0].mean(), error[1, :2].mean(), error[2].mean(), error[3].mean()])
    torch.testing.assert_close(loss, expected)
    loss.sum().backward()
    assert all(p.grad is None for network in (student.ema, student.teacher) for p in network.parameters())
    assert student.network.dit.head.bias.grad.abs().sum() > 0


def test_what_a_student_copies_drops_nothing(tmp_path):
    folder = save_teacher(tmp_path / "teacher", dropout=0.5)
    student = make_csa(stage="student", teacher=str(folder), dropout=0.5).train()
    assert student.network.training
    assert not any(module.training for part in (student.ema, student.teacher) for module in part.modules())


def test_distilling_teaches_to_leap_where_the_teacher_walks(tmp_path):
    torch.manual_seed(0)
    settings = {"dropout": 0.0, "ema_decay": 0.9, "optimizer_lr": 5e-3, "samples_per_item": 4}
    settings |= {"levels": 20, "num_inference_steps": 19, "p_mean": -1.2}
    teacher, data = make_csa(**settings), data_of(32)

    def learn(policy: PreTrainedPolicy, steps: int) -> None:
        optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
        for _ in range(steps):
            loss, _ = policy.train()(data)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            policy.update()

    learn(teacher, 100)
    walked = teacher.predict_action_chunk(data)
    save_policy(tmp_path / "teacher", "csa_assist", policy=teacher)
    student = make_csa(stage="student", teacher=str(tmp_path / "teacher"), **settings)
    before = (student.predict_action_chunk(data) - walked).square().mean().sqrt()  # from the same noise
    learn(student, 150)
    student.reset()
    student._episodes._next = 0
    after = (student.predict_action_chunk(data) - walked).square().mean().sqrt()
    assert before > 0.8 * walked.std() and after < 0.5 * before


# --- Acting ---


def test_a_teacher_samples_by_heun_steps_and_a_student_by_one_evaluation(teacher, student):
    data = data_of(3)
    for policy, evaluations in [(load(teacher), 2 * FLOW["num_inference_steps"]), (student, 1)]:
        bound, noise = policy.velocity(data), torch.randn(3, T, 2)
        chunk = policy.sample(bound, noise)
        assert bound.evaluations == evaluations and chunk.shape == (3, T, 2) and chunk.isfinite().all()
        if policy is student:
            leap = Denoiser(policy.velocity(data), policy.config.noise, identity=0.002)
            torch.testing.assert_close(chunk, leap(80 * noise, torch.full((3,), 80.0)))
    assert make_policy_config("csa_assist").num_inference_steps == make_policy_config("csa_assist").levels - 1


def test_an_edit_is_one_evaluation_and_always_the_same(student):
    assert isinstance(student, Adapter) and set(student.editors) == {"csa"} and not student.scores
    data = data_of(4)
    bound = student.bind({key: value for key, value in data.items() if key != "observation.goal"})
    state = torch.get_rng_state()
    edited = bound.edit(data["action"], CSA(level=30), score=None, threshold=None, length=4, generator=None)
    assert bound.evaluations == 1
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(student.bind(data).edit(data["action"], CSA(level=30)), edited)
    assert (edited != data["action"]).all()
    rows = torch.tensor([True, False, False, True])
    some = bound.select(rows)
    torch.testing.assert_close(some.edit(data["action"][rows], CSA(level=30)), edited[rows])
    assert (some.evaluations, bound.evaluations) == (1, 1)
    kept = student.bind(data).edit(data["action"], CSA(level=30, blend=1.0))
    assert torch.equal(kept, data["action"])


def test_an_edit_follows_the_observation_and_never_the_goal(student):
    data = data_of(2)
    edited = student.bind(data).edit(data["action"], CSA())
    other_goal = {**data, "observation.goal": data["observation.goal"] + 1}
    other_state = {**data, "observation.state": data["observation.state"] + 1}
    assert torch.equal(student.bind(other_goal).edit(data["action"], CSA()), edited)
    assert not torch.allclose(student.bind(other_state).edit(data["action"], CSA()), edited, atol=1e-3)


def test_a_teacher_corrects_nothing_and_says_what_to_do(teacher):
    with pytest.raises(ValueError, match=f"{teacher} is a csa_assist teacher, which corrects nothing: distil") as error:
        load(teacher).bind(data_of(2))
    assert f"--policy.stage=student --policy.teacher={teacher}" in str(error.value) and "\n" not in str(error.value)


def test_the_wrapper_corrects_by_a_student_and_refuses_a_teacher(tmp_path, teacher, student):
    agent = save_policy(tmp_path / "agent", "act")
    adapter = save_policy(tmp_path / "student", "csa_assist", policy=student)
    data = observation(3)
    with torch.inference_mode():
        proposal = wrap(agent).select_action(data)
        for method in (None, "csa:level=30,blend=0.2", "csa:blend=1"):
            policy = wrap(agent, adapter=adapter, method=method)
            action = policy.select_action(data)
            assert policy.correction.edited.all()
            changed = method != "csa:blend=1"
            assert policy.correction.evaluations.tolist() == 3 * [float(changed)]
            assert torch.allclose(action, proposal, atol=1e-5) != changed
        with pytest.raises(ValueError, match="is a csa_assist teacher, which corrects nothing: distil it"):
            wrap(agent, adapter=teacher).select_action(data)


def test_images_are_a_context_too(tmp_path):
    folder, data = save_teacher(tmp_path / "teacher", "pixels_agent_pos"), observation(2, "pixels_agent_pos")
    name = "ResNet18_Weights.IMAGENET1K_V1"  # which a student neither fetches nor needs
    student = make_csa("pixels_agent_pos", stage="student", teacher=str(folder), pretrained_backbone_weights=name)
    data["action"] = torch.randn(2, T, 2)
    loss, _ = student.train()(data)
    assert loss.isfinite()
    edited = student.bind(data).edit(data["action"], CSA())
    data[CAMERA] = 1 - data[CAMERA]
    assert not torch.equal(student.bind(data).edit(data["action"], CSA()), edited)


# --- Bad input ---


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 32}, "has width=16, but the student has 32: they must agree"),
        ({"sigma_data": 0.5}, "has sigma_data=1.0, but the student has 0.5"),
        ({"sigma_max": 40.0}, "has sigma_max=80.0, but the student has 40.0"),
        ({"exclude_features": ["observation.goal", "observation.state"]}, "has input_features="),
    ],
)
def test_a_teacher_of_another_kind_is_one_clear_line(teacher, options, message):
    with pytest.raises(ValueError) as error:
        make_csa(stage="student", teacher=str(teacher), **options)
    assert f"--policy.teacher={teacher} {message}" in str(error.value) and "\n" not in str(error.value)


def test_only_a_teacher_can_be_distilled(tmp_path, student):
    agent = save_policy(tmp_path / "agent", "gloves_expert_flow")
    save_policy(tmp_path / "student", "csa_assist", policy=student)
    for folder, kind in [(agent, "policy of type 'gloves_expert_flow'"), (tmp_path / "student", "csa_assist student")]:
        with pytest.raises(ValueError, match=f"{folder} is a {kind}, but a student is distilled from a csa") as error:
            make_csa(stage="student", teacher=str(folder))
        assert "--policy.stage=teacher" in str(error.value) and "\n" not in str(error.value)


def test_levels_may_be_counted_anew(teacher):
    student = make_csa(stage="student", teacher=str(teacher), levels=18)
    assert student.config.noise.levels == 18
    with pytest.raises(ValueError, match="the student's levels are 0 to 17"):
        student.bind(data_of(1)).edit(torch.zeros(1, T, 2), CSA(level=18))
