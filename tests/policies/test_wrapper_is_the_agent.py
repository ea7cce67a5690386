"""Without an editor, or where the gate admits everything, the wrapper is the agent: bit for bit, at every step."""

import pytest
import torch

from tests.builders import calibrate, load, play, save_policy, slalom

AGENTS = [
    ("gloves_flow_policy", "state"),
    ("gloves_flow_policy", "pixels_agent_pos"),
    ("act", "state"),
    ("act", "pixels_agent_pos"),
    ("act_ensembled", "state"),
    ("act_ensembled", "pixels_agent_pos"),
    ("diffusion", "state"),
    ("diffusion", "pixels_agent_pos"),
    ("vqbet", "pixels_agent_pos"),
    ("tdmpc", "state"),  # its chunks are (n, B, A), and here n is B
]


@pytest.fixture(scope="module")
def adapters(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adapters")
    return {
        obs_type: calibrate(save_policy(folder / obs_type, "gloves_expert_flow", obs_type, seed=7))
        for obs_type in ("state", "pixels_agent_pos")
    }


@pytest.mark.parametrize(("kind", "obs_type"), AGENTS)
def test_executed_actions_equal_the_bare_agents(tmp_path, adapters, kind, obs_type):
    agent = save_policy(tmp_path / "agent", kind, obs_type)
    wrapped = {
        "no adapter": ["--wrap=gloves"],
        "all admitted": ["--wrap=gloves", f"--adapter={adapters[obs_type]}", "--gate=true", "--alpha=0"],
        "no editor": ["--wrap=gloves", f"--adapter={adapters[obs_type]}", "--method=none"],
    }
    # Rendering takes its time; a second batch shows that episodes begin alike.
    length, batches = (23, 2) if obs_type == "state" else (13, 1)
    with slalom(obs_type, episode_length=length) as env:

        def episodes(*options: str) -> list[torch.Tensor]:
            # As in `lerobot-eval`: seeded once, before the policy is made, which draws random numbers too.
            torch.manual_seed(0)
            policy, pipelines = load(agent, *options)
            played = [play(env, policy, pipelines, first_seed=100 + 2 * batch) for batch in range(batches)]
            if any(option.startswith("--adapter") for option in options):
                assert policy.statistics()["chunks"] > 0
            return played

        bare = episodes()
        assert all(actions.shape == (2, length, 2) for actions in bare)
        assert all((actions[:, 1:] != actions[:, :-1]).any() for actions in bare)
        for name, options in wrapped.items():
            for expected, actions in zip(bare, episodes(*options), strict=True):
                assert torch.equal(actions, expected), name


def test_an_editor_does_change_them(tmp_path, adapters):
    agent = save_policy(tmp_path / "agent", "act")
    with slalom(episode_length=12) as env:
        bare = play(env, *load(agent))
        edited = play(env, *load(agent, "--wrap=gloves", f"--adapter={adapters['state']}"))
    assert (edited != bare).all()


def test_the_agent_keeps_its_own_schedule(tmp_path, adapters):
    """It plans anew when its chunk is used up, whatever the adapter's chunk size."""
    agent = save_policy(tmp_path / "agent", "act")  # 5 actions of a chunk of 8; the adapter's chunks have 6
    policy, pipelines = load(agent, "--wrap=gloves", f"--adapter={adapters['state']}")
    steps = []
    planner = policy._agent.policy
    planner.model.register_forward_hook(lambda *_: steps.append(policy._step))
    with slalom(episode_length=23) as env:
        play(env, policy, pipelines)
    assert steps == [0, 5, 10, 15, 20]


def test_neither_agent_nor_adapter_is_among_its_weights(tmp_path, adapters):
    policy, _ = load(save_policy(tmp_path / "agent", "act"), "--wrap=gloves", f"--adapter={adapters['state']}")
    assert not policy.state_dict() and not list(policy.parameters()) and len(list(policy.modules())) == 1
    policy.save_pretrained(tmp_path / "wrapper")
    assert sorted(path.name for path in (tmp_path / "wrapper").iterdir()) == [
        "config.json",
        "policy_postprocessor.json",
        "policy_preprocessor.json",
    ]


def test_it_cannot_be_trained(tmp_path):
    policy, _ = load(save_policy(tmp_path / "agent", "act"), "--wrap=gloves")
    for refused in (policy.get_optim_params, policy.config.get_optimizer_preset, lambda: policy.forward({})):
        with pytest.raises(ValueError, match=r"train an adapter, such as --policy\.type=gloves_expert_flow"):
            refused()
