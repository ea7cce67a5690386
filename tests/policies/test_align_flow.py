"""The align flow learns each source's own chunks, from data that LeRobot's tools merged, and edits by both flows."""

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.datasets.dataset_tools import merge_datasets
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies import make_pre_post_processors
from lerobot.scripts.lerobot_train import train
from torch.utils.data import DataLoader

from lerobot_gloves.adapter import Adapter
from lerobot_gloves.checkpoints.calibration import Calibration
from lerobot_gloves.commands.calibrate import calibrate as calibrate_command
from lerobot_gloves.editors import FEEG, IFAE
from lerobot_gloves.recording.sources import SOURCES, agent_task
from lerobot_policy_gloves.gloves_align_flow.configuration_gloves_align_flow import LABEL
from tests.builders import (
    load,
    make_config,
    make_policy,
    observation,
    save_policy,
    training_options,
    wrap,
    write_dataset,
)
from tests.policies.proposals import write_agent_dataset
from tests.policies.test_training_command import LAST

T = 6
"""Chunk size."""


@pytest.fixture(scope="module")
def proposals() -> np.ndarray:
    """Five episodes of three proposals."""
    return np.random.default_rng(1).normal(size=(5, 3, T, 2))


@pytest.fixture(scope="module")
def merged(tmp_path_factory, proposals) -> LeRobotDataset:
    """Four episodes of the expert and five of an agent, one dataset by LeRobot's tool."""
    folder = tmp_path_factory.mktemp("data")
    write_dataset(folder / "expert")
    write_agent_dataset(folder / "agent", proposals)
    parts = [LeRobotDataset(f"me/{name}", root=folder / name) for name in ("expert", "agent")]
    return merge_datasets(parts, "me/tiny", folder / "merged")


def normalised(chunk: torch.Tensor, stats: dict) -> torch.Tensor:
    return (chunk - torch.as_tensor(stats["mean"])) / torch.as_tensor(stats["std"])


def test_every_row_trains_on_the_whole_chunk_that_it_belongs_to(merged, proposals):
    config = make_config("gloves_align_flow", sources=[])
    dataset = LeRobotDataset(
        "me/tiny", root=merged.root, delta_timestamps=resolve_delta_timestamps(config, merged.meta)
    )
    policy = type(make_policy("gloves_align_flow"))(config, dataset_meta=dataset.meta)
    preprocess, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    (batch,) = DataLoader(dataset, batch_size=len(dataset))
    made = policy._chunks(preprocess(batch))
    stats = dataset.meta.stats["action"]
    agent = torch.tensor([task != "0 2 3" for task in batch["task"]])
    assert agent.sum() == proposals.size // 2 and (~agent).sum() == 4 * 12

    whole = torch.tensor(proposals, dtype=torch.float32).flatten(0, 1).repeat_interleave(T, dim=0)
    torch.testing.assert_close(made["action"][agent], normalised(whole, stats).float())
    assert not made["action_is_pad"][agent].any()

    # The expert's: the next T actions of the episode, twelve a time.
    actions = batch["action"][~agent][:, T - 1].view(4, 12, 2)
    for episode in range(4):
        for step in range(12):
            row, left = 12 * episode + step, min(T, 12 - step)
            expected = normalised(actions[episode, step : step + left], stats).float()
            torch.testing.assert_close(made["action"][~agent][row, :left], expected)
            assert made["action_is_pad"][~agent][row].tolist() == [False] * left + [True] * (T - left)

    labels = made[LABEL].argmax(1)
    assert made[LABEL].sum(1).eq(1).all()
    assert set(labels[agent].tolist()) == {SOURCES.index("noised")} and not labels[~agent].any()
    assert policy.config.sources == ["expert", "noised"]


def test_each_source_is_sampled_from_its_own_flow_and_ifae_carries_one_to_the_other():
    """The agent acts as the expert but for a shift of all its actions: taking that back is what IFAE is for."""
    torch.manual_seed(0)
    shift = torch.tensor([1.5, -1.0])
    policy = make_policy(
        "gloves_align_flow", width=32, dropout=0.0, context_dropout=0.0, ema_decay=0.9, optimizer_lr=5e-3
    )
    policy.config.fps = 20
    policy.config.agent_source = "noised"
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())

    def batch_of(rows: int, seed: int) -> tuple[dict, torch.Tensor]:
        seen = observation(rows, seed=seed)
        chunk = 0.5 * seen["observation.state"][:, None, :2] + torch.linspace(-1, 1, T)[:, None]
        return seen, chunk

    for step in range(250):
        seen, chunk = batch_of(32, step)
        drawn = torch.randint(T, (32,))
        action = torch.zeros(32, 2 * T - 1, 2)
        for row in range(16):  # the agent's, each at another row of its block
            begin = T - 1 - drawn[row]
            action[row, begin : begin + T] = chunk[row] + shift
        action[16:, T - 1 :] = chunk[16:]
        batch = {
            **seen,
            "action": action,
            "action_is_pad": torch.zeros(32, 2 * T - 1, dtype=torch.bool),
            "timestamp": (drawn + 3 * T) / 20,
            "task": 16 * [agent_task("noised", T)] + 16 * ["0 2 3"],
        }
        loss, _ = policy.train()(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
    seen, chunk = batch_of(64, 1000)
    noise = torch.randn(64, T, 2)
    policy.eval()
    expert, agent = (policy.sample(v, noise) for v in (policy.velocity(seen), policy.agent_velocity(seen)))
    near = 0.1 * shift.square().mean()
    assert (expert - chunk).square().mean() < near and (agent - chunk - shift).square().mean() < near
    assert (policy.predict_action_chunk(seen) - chunk).square().mean() < near

    proposal = chunk + shift
    edited = policy.bind(seen).edit(proposal, IFAE())
    assert (edited - chunk).square().mean() < near


@pytest.fixture
def align():
    policy = make_policy("gloves_align_flow")
    policy.config.agent_source = "noised"
    return policy


def test_it_is_an_adapter_that_edits_by_ifae_if_nothing_else_is_said(align):
    assert isinstance(align, Adapter)
    assert align.default_editor == "ifae" and {"ifae", "feeg", "fpas"} <= align.editors.keys()
    assert "reverse" in align.scores


def test_ifae_asks_the_one_network_once_a_step_and_binds_the_agent_only_then(align):
    calls, goals = [], []
    network = align.ema.module
    network.dit.register_forward_hook(lambda module, inputs, output: calls.append(len(output)))
    network.goal_encoder.register_forward_hook(lambda *_: goals.append(1))
    network.state_encoder.register_forward_hook(lambda *_: goals.append("state"))
    bound, chunk = align.bind(observation(batch=3)), torch.randn(3, T, 2)
    bound.score(chunk, align.scores["reverse"](steps=2))
    assert (calls, goals, bound.evaluations) == ([3, 3], ["state", 1], 2)
    some = bound.select(torch.tensor([True, False, True]))
    some.edit(chunk[::2], IFAE(steps=4))
    assert (calls[2:], goals, some.evaluations) == (4 * [2 * 2], ["state", 1, 1], 4 * 2)
    some.edit(chunk[::2], IFAE(steps=4, guidance=2.0))
    assert (calls[6:], goals, some.evaluations) == (4 * [3 * 2], ["state", 1, 1], 4 * 2 + 4 * 3)


def test_images_are_looked_at_once_for_both_flows():
    align = make_policy("gloves_align_flow", "pixels_agent_pos")
    calls = []
    (encoder,) = align.ema.module.image_encoders
    encoder.register_forward_hook(lambda *_: calls.append(1))
    seen, chunk = observation(2, "pixels_agent_pos"), torch.randn(2, T, 2)
    edited = align.bind(seen).edit(chunk, IFAE(steps=2))
    assert len(calls) == 1 and not torch.equal(edited, chunk)


def test_an_edit_of_some_contexts_is_that_of_those_rows(align):
    seen, chunk = observation(batch=3), torch.randn(3, T, 2)
    rows = torch.tensor([True, False, True])
    editor = IFAE(steps=3)

    def edit(bound, proposal):
        return bound.edit(proposal, editor, generator=torch.Generator().manual_seed(0))

    alone = align.bind({key: value[rows] for key, value in seen.items()})
    torch.testing.assert_close(edit(align.bind(seen).select(rows), chunk[rows]), edit(alone, chunk[rows]))


def test_the_label_is_what_tells_expert_and_agent_apart(align):
    seen, x, t = observation(2), torch.randn(2, T, 2), torch.rand(2)
    fields = {source: align.velocity(seen, source)(x, t) for source in SOURCES}
    for one, other in [("expert", "noised"), ("none", "noised"), ("slow", "laggy")]:
        assert (fields[one] - fields[other]).abs().max() > 1e-4
    assert torch.equal(align.agent_velocity(seen)(x, t), fields["noised"])
    torch.testing.assert_close(align.bind(seen).expert(x, t), fields["expert"])


def test_edits_are_the_same_inside_inference_mode(align):
    batch, chunk = observation(batch=2), torch.randn(2, T, 2)
    for editor in (IFAE(steps=3), FEEG(steps=3)):

        def edit(batch, editor=editor):
            generator = torch.Generator().manual_seed(0)
            return align.bind(batch).edit(chunk, editor, generator=generator)

        expected = edit(batch)
        with torch.inference_mode():
            assert torch.equal(edit({key: value.clone() for key, value in batch.items()}), expected)


def test_the_goal_is_never_part_of_the_context(align):
    seen, x, t = observation(2), torch.randn(2, T, 2), torch.rand(2)
    other = {**seen, "observation.goal": seen["observation.goal"] + 1}
    assert torch.equal(align.velocity(seen)(x, t), align.velocity(other)(x, t))


@pytest.mark.parametrize(
    ("sources", "chosen", "source"),
    [
        (["expert", "noised"], None, "noised"),
        (["expert", "none", "slow"], None, "none"),
        (["expert", "none", "slow"], "slow", "slow"),
        (["slow"], None, "slow"),
    ],
)
def test_the_agents_source_is_the_only_one_or_none_unless_chosen(sources, chosen, source):
    assert make_config("gloves_align_flow", sources=sources, agent_source=chosen).resolve_agent_source() == source


def test_a_source_that_was_not_trained_is_refused_with_those_that_were():
    cases = [
        (["expert", "none", "slow"], "laggy", "'laggy', which .* choose from none, slow"),
        (["expert", "noised", "slow"], None, "'none', which .* choose from noised, slow"),
        (["expert"], None, "choose from nothing, it has seen no agent"),
    ]
    for sources, chosen, message in cases:
        policy = make_policy("gloves_align_flow", sources=sources, agent_source=chosen)
        bound = policy.bind(observation(2))  # scoring and the other editors need no agent
        with pytest.raises(ValueError, match=message):
            bound.edit(torch.zeros(2, T, 2), IFAE())
    with pytest.raises(ValueError, match="agent_source is 'noisy': choose from none, noised, laggy, slow, shift"):
        make_config("gloves_align_flow", agent_source="noisy")
    with pytest.raises(ValueError, match="has seen no expert, only slow"):
        make_policy("gloves_align_flow", sources=["slow"]).bind(observation(2))


def test_the_wrapper_chooses_the_agents_source_by_the_adapters_own_option(checkpoints, tmp_path):
    adapter, batch = save_policy(tmp_path / "adapter", "gloves_align_flow"), observation(3)
    executed = {}
    for source in ("none", "noised"):
        policy = wrap(checkpoints.agent, adapter=adapter, adapter_overrides=[f"--agent_source={source}"])
        assert policy._corrector.editor == IFAE()
        executed[source] = policy.select_action(batch)
    assert not torch.allclose(executed["none"], executed["noised"], atol=1e-6)
    default = wrap(checkpoints.agent, adapter=adapter).select_action(batch)
    assert torch.equal(default, executed["none"])


def test_data_without_an_agent_is_one_clear_line(tmp_path, typed):
    write_dataset(tmp_path / "data")
    typed(*training_options("gloves_align_flow", tmp_path / "data", tmp_path / "run"))
    with pytest.raises(
        ValueError, match="holds the expert's chunks alone: record an agent's by gloves record"
    ) as error:
        train()
    assert "\n" not in str(error.value)


def test_proposals_of_another_length_are_one_clear_line(merged):
    config = make_config("gloves_align_flow", chunk_size=4, n_action_steps=4)
    with pytest.raises(ValueError, match=f"proposals of {T} actions, but chunk_size is 4"):
        type(make_policy("gloves_align_flow"))(config, dataset_meta=merged.meta)


@pytest.mark.slow
def test_lerobot_train_and_gloves_calibrate_take_the_merged_data(merged, tmp_path, typed):
    typed(*training_options("gloves_align_flow", merged.root, tmp_path / "run", steps=20), "--save_freq=20")
    train()
    folder = tmp_path / "run" / LAST / "pretrained_model"
    policy, _ = load(folder)
    assert policy.config.sources == ["expert", "noised"]
    assert set(policy.config.input_features) == {"observation.state", "observation.environment_state"}

    typed(f"--policy.path={folder}", "--dataset.repo_id=me/tiny", f"--dataset.root={merged.root}", "--stride=1")
    calibrate_command()
    calibration = Calibration.load(folder)
    assert calibration.episodes == (3,)  # of what was held out, 3 of the expert's and 7, 8 of the agent's
    assert {table.shape for table in calibration.scores.values()} == {(T, 12 - T + 1)}

    typed(
        f"--policy.path={folder}",
        "--dataset.repo_id=me/tiny",
        f"--dataset.root={merged.root}",
        "--dataset.episodes=[7, 8]",
    )
    with pytest.raises(ValueError, match="all 2 episodes are an agent's: calibrate on the expert's"):
        calibrate_command()
