"""Tiny policies, calibrations and data, on disk as LeRobot leaves them.

Policies are randomly initialised for Slalom's observations, and saved with processors whose statistics are far from the
identity: an action that skips its normalisation, or goes through it twice, is another action.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets import LeRobotDataset
from lerobot.envs import make_env
from lerobot.policies import get_policy_class, make_policy_config, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from torch import Tensor, nn

import lerobot_policy_gloves  # noqa: F401, registers the policies
from lerobot_gloves.checkpoints.calibration import Calibration, weights_hash
from lerobot_gloves.tasks.slalom import SlalomEnv
from lerobot_policy_gloves.gloves.modeling_gloves import GlovesPolicy

type Pipelines = tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]

CAMERA = "observation.images.front"
SIZE = 64
"""Height and width of images."""

FLOW = {
    "chunk_size": 6,
    "n_action_steps": 4,
    "context_dim": 16,
    "width": 16,
    "depth": 1,
    "heads": 2,
    "time_dim": 16,
    "num_inference_steps": 2,
    "pretrained_backbone_weights": None,
}
ACT = {
    "chunk_size": 8,
    "n_action_steps": 5,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 16,
    "n_encoder_layers": 1,
    "n_vae_encoder_layers": 1,
    "latent_dim": 4,
    "pretrained_backbone_weights": None,
}
KINDS: dict[str, dict[str, Any]] = {
    "gloves_flow_policy": FLOW,
    "gloves_expert_flow": FLOW,
    "gloves_copilot": FLOW | {"history": 2},
    "gloves_align_flow": FLOW | {"sources": ["expert", "none", "noised"]},
    "act": ACT,
    "diffusion": {
        "n_obs_steps": 2,
        "horizon": 8,
        "n_action_steps": 4,
        "down_dims": (8, 16),
        "n_groups": 2,
        "diffusion_step_embed_dim": 8,
        "spatial_softmax_num_keypoints": 4,
        "num_train_timesteps": 10,
        "num_inference_steps": 2,
        "pretrained_backbone_weights": None,
    },
    "vqbet": {
        "n_obs_steps": 2,
        "action_chunk_size": 3,
        "n_action_pred_token": 2,
        "crop_shape": (56, 56),
        "gpt_input_dim": 16,
        "gpt_output_dim": 16,
        "gpt_hidden_dim": 16,
        "gpt_n_layer": 1,
        "gpt_n_head": 2,
        "vqvae_embedding_dim": 8,
        "vqvae_enc_hidden_dim": 8,
        "spatial_softmax_num_keypoints": 4,
        "pretrained_backbone_weights": None,
    },
    "tdmpc": {
        "n_action_repeats": 1,
        "n_action_steps": 2,
        "horizon": 2,
        "latent_dim": 4,
        "mlp_dim": 8,
        "state_encoder_hidden_dim": 8,
        "q_ensemble_size": 2,
        "cem_iterations": 1,
        "n_gaussian_samples": 8,
        "n_pi_samples": 2,
        "n_elites": 4,
    },
}
"""Options of the smallest sensible policy of each type."""

FORMS = {"act_ensembled": ("act", {"temporal_ensemble_coeff": 0.01, "n_action_steps": 1})}
"""Names of policies that are a type with other options."""


def features(obs_type: str = "state") -> tuple[dict[str, PolicyFeature], dict[str, PolicyFeature]]:
    """Slalom's input and output features under LeRobot's keys."""
    action = {"action": PolicyFeature(FeatureType.ACTION, (2,))}
    inputs = {
        "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
        "observation.goal": PolicyFeature(FeatureType.STATE, (9,)),
    }
    if obs_type == "state":
        return inputs | {"observation.environment_state": PolicyFeature(FeatureType.ENV, (12,))}, action
    return inputs | {CAMERA: PolicyFeature(FeatureType.VISUAL, (3, SIZE, SIZE))}, action


def statistics(feature_shapes: dict[str, PolicyFeature]) -> dict[str, dict[str, np.ndarray]]:
    """Dataset statistics, another one for each entry of each feature."""
    rng, result = np.random.default_rng(5), {}
    for key, feature in feature_shapes.items():
        shape = (3, 1, 1) if feature.type is FeatureType.VISUAL else feature.shape
        # Actions of millimetres, as Slalom's are.
        scale = 0.004 if feature.type is FeatureType.ACTION else 0.5
        mean = scale * rng.normal(size=shape)
        std = scale * rng.uniform(0.5, 1.5, size=shape)
        # Nothing that a policy of random weights does with an action shall be too far for its data.
        width = std * (20 if feature.type is FeatureType.ACTION else 2)
        low, high = mean - width, mean + width
        result[key] = {"mean": mean, "std": std, "min": low, "max": high, "q01": low, "q99": high}
    return {key: {name: value.astype(np.float32) for name, value in s.items()} for key, s in result.items()}


def make_config(kind: str, obs_type: str = "state", **options: Any) -> PreTrainedConfig:
    """Configuration of a tiny policy: of a type of `KINDS`, or of a name of `FORMS`."""
    name, extra = FORMS.get(kind, (kind, {}))
    inputs, outputs = features(obs_type)
    if not name.startswith("gloves"):
        inputs.pop("observation.goal")
    made = {"input_features": inputs, "output_features": outputs, "device": "cpu", "push_to_hub": False}
    return make_policy_config(name, **{**made, **KINDS.get(name, {}), **extra, **options})


def make_policy(kind: str, obs_type: str = "state", *, seed: int = 0, **options: Any) -> PreTrainedPolicy:
    """A tiny policy, every weight of which matters."""
    config = make_config(kind, obs_type, **options)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        policy = get_policy_class(config.type)(config)
        awaken(policy)
    return policy.eval()


def awaken(module: nn.Module) -> None:
    """Fill weights that are initialised with zeros, as AdaLN-Zero's are, with small noise; averages follow."""
    for parameter in module.parameters():
        if parameter.ndim > 0 and not parameter.any():
            nn.init.normal_(parameter, std=0.1)
    if hasattr(module, "ema"):
        module.ema.module.load_state_dict(module.network.state_dict())


def save_policy(
    folder: Path,
    kind: str,
    obs_type: str = "state",
    *,
    seed: int = 0,
    policy: PreTrainedPolicy | None = None,
    **options: Any,
) -> Path:
    """Save a tiny policy, or the given one, with its processors, as `lerobot-train` does; returns the folder."""
    policy = policy or make_policy(kind, obs_type, seed=seed, **options)
    config = policy.config
    stats = statistics({**config.input_features, **config.output_features})
    policy.save_pretrained(folder)
    for pipeline in make_pre_post_processors(config, dataset_stats=stats):
        pipeline.save_pretrained(folder)
    return folder


def calibrate(
    folder: Path,
    *,
    scores: dict[str, Tensor] | None = None,
    chunk_size: int = FLOW["chunk_size"],
    episode_of: tuple[int, ...] = (),
) -> Path:
    """Give a saved adapter a calibration: scores (T, n) by specification, by default 1 to 99 for `reverse:steps=1`."""
    if scores is None:
        scores = {"reverse:steps=1": torch.arange(1.0, 100.0).expand(chunk_size, -1)}
    config = PreTrainedConfig.from_pretrained(folder)
    adapter = get_policy_class(config.type).from_pretrained(folder)
    weights = weights_hash(adapter.state_dict())
    about = {"repo_id": "me/expert", "revision": "v3.0", "episodes": (7, 8), "episode_of": episode_of}
    Calibration(scores=scores, weights=weights, **about).save(folder)
    return folder


def wrap(agent: Path, *, adapter: Path | None = None, **options: Any) -> GlovesPolicy:
    """The wrapper around a saved agent."""
    options["adapter"] = None if adapter is None else str(adapter)
    return GlovesPolicy(make_policy_config("gloves", agent=str(agent), **options)).eval()


def load(folder: Path, *overrides: str) -> tuple[PreTrainedPolicy, Pipelines]:
    """A policy and its pipelines as `--policy.path=folder --policy.<override>` loads them."""
    config = PreTrainedConfig.from_pretrained(folder, cli_overrides=list(overrides))
    config.pretrained_path = folder
    policy = get_policy_class(config.type).from_pretrained(config.pretrained_path, config=config)
    return policy, make_pre_post_processors(config, str(config.pretrained_path))


@contextmanager
def slalom(obs_type: str = "state", *, batch: int = 2, episode_length: int = 25) -> Iterator[gym.vector.VectorEnv]:
    """LeRobot's vector environment of Slalom."""
    env_config = SlalomEnv(obs_type=obs_type, episode_length=episode_length, image_size=SIZE)
    env = make_env(env_config, n_envs=batch)[env_config.type][0]
    try:
        yield env
    finally:
        env.close()


def play(env: gym.vector.VectorEnv, policy: PreTrainedPolicy, pipelines: Pipelines, *, first_seed: int = 100) -> Tensor:
    """Executed actions (B, steps, A) of a batch of whole episodes in LeRobot's own loop."""
    from lerobot.scripts.lerobot_eval import rollout  # takes seconds to import

    identity = PolicyProcessorPipeline(steps=[])
    result = rollout(env, policy, identity, identity, *pipelines, seeds=[first_seed + i for i in range(env.num_envs)])
    return result["action"]


def observation(batch: int = 2, obs_type: str = "state", *, seed: int = 0) -> dict[str, Tensor]:
    """Raw observations (B, ...) under LeRobot's keys; images are floats in [0, 1]."""
    generator = torch.Generator().manual_seed(seed)
    inputs, _ = features(obs_type)
    draw = {FeatureType.VISUAL: torch.rand}
    return {
        key: draw.get(feature.type, torch.randn)((batch, *feature.shape), generator=generator)
        for key, feature in inputs.items()
    }


def write_dataset(
    root: Path,
    obs_type: str = "state",
    *,
    episodes: int = 4,
    length: int | Sequence[int] = 12,
    leave_out: Sequence[str] = (),
    video: bool = False,
) -> LeRobotDataset:
    """A LeRobotDataset of Slalom's observations: the action is a linear function of the state, images are noise."""
    shapes = {key: one for some in features(obs_type) for key, one in some.items() if key not in leave_out}
    names = {key: [f"{key.split('.')[-1]}_{i}" for i in range(feature.shape[0])] for key, feature in shapes.items()}
    columns = {key: {"dtype": "float32", "shape": shapes[key].shape, "names": names[key]} for key in shapes}
    if CAMERA in shapes:
        columns[CAMERA] = {"shape": (SIZE, SIZE, 3), "names": ["height", "width", "channels"]}
        columns[CAMERA]["dtype"] = "video" if video else "image"
    dataset = LeRobotDataset.create("me/tiny", fps=20, root=root, features=columns, use_videos=video)
    mixing = 0.01 * (rng := np.random.default_rng(0)).normal(size=(4, 2))
    for episode in range(episodes):
        for _ in range(length if isinstance(length, int) else length[episode]):
            state = rng.normal(size=4)
            row = {
                "observation.state": state,
                "observation.goal": np.eye(9)[episode % 9],
                "observation.environment_state": np.arange(12.0),
                "action": state @ mixing,
                CAMERA: rng.uniform(size=(SIZE, SIZE, 3)),
            }
            dataset.add_frame({key: np.asarray(row[key], np.float32) for key in shapes} | {"task": "0 2 3"})
        dataset.save_episode()
    dataset.finalize()
    return dataset


def training_options(kind: str, root: Path, output: Path, *, steps: int = 100_000) -> list[str]:
    """What `lerobot-train` needs for a tiny adapter on the dataset that `write_dataset` left in `root`."""
    network = {key: "null" if value is None else value for key, value in FLOW.items()}
    return [
        f"--policy.type={kind}",
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        *(f"--policy.{key}={value}" for key, value in network.items()),
        "--dataset.repo_id=me/tiny",
        f"--dataset.root={root}",
        "--dataset.eval_split=0.25",
        "--batch_size=4",
        "--num_workers=0",
        f"--steps={steps}",
        "--save_freq=2",
        "--eval_steps=2",
        "--log_freq=1",
        f"--output_dir={output}",
    ]
