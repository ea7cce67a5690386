"""The baseline `csa_assist`: a diffusion teacher, its consistency student, and the student as an adapter."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, cast

import torch
from huggingface_hub.errors import HFValidationError
from lerobot.configs import PreTrainedConfig
from torch import Tensor

from gloves_flow.modeling_flow import FlowPolicy
from lerobot_gloves.checkpoints.loading import load_weights
from lerobot_gloves.editors import Reference
from lerobot_gloves.networks import BoundVelocity, VelocityNetwork

from .configuration_csa_assist import SHARED, CsaAssistConfig
from .consistency import distillation_loss
from .editor import CSA
from .edm import Denoiser, edm_loss, solve


class CsaAssistPolicy(FlowPolicy):
    """Consistency shared autonomy (Sun et al., "FlashBack", CoRL 2025) on action chunks.

    The flow's network, in the place of the raw network F of a diffusion model. The teacher is trained as Karras et al.
    (2022) train theirs. The student, which starts from the teacher's averaged weights, learns to do in one evaluation
    what the teacher does in many. As an adapter a student edits proposals by CSA; it scores none. As a policy by itself
    either acts like the expert, without a goal.

    Raises:
        ValueError: If a new student's teacher is missing, or is none that it could start from.
    """

    config_class = CsaAssistConfig
    name = "csa_assist"
    about = "A consistency model of an expert's actions that assists in one evaluation (FlashBack's shared autonomy)."
    editors: Mapping[str, type] = {"csa": CSA}
    default_editor = "csa"
    scores: Mapping[str, type] = {}

    def __init__(self, config: CsaAssistConfig, **kwargs: object):
        config.validate_features()  # before its teacher is looked for
        if config.stage == "student" and not config.pretrained_path:
            config.backbone_norm = config.backbone_norm or teacher_of(config).backbone_norm
        super().__init__(config, **kwargs)
        if config.stage == "student" and not config.pretrained_path:
            for network in (self.network, self.averaged):
                network.load_state_dict(self.teacher.state_dict())

    @cached_property  # which keeps it beside the modules, not among them: it is not saved with the student
    def teacher(self) -> VelocityNetwork:
        """The network that is distilled; only a student's training asks for it."""
        return load_teacher(self.config)

    def train(self, mode: bool = True) -> "CsaAssistPolicy":
        super().train(mode)
        self.ema.eval()  # As a student's target it drops nothing.
        return self

    def forward(self, batch: dict[str, Tensor], reduction: str = "mean") -> tuple[Tensor, dict]:
        """Loss of the stage, of the trained weights, or in eval mode of the averaged ones (see `FlowPolicy`).

        A student's target network are the averaged weights.
        """
        if self.config.stage == "teacher":
            return super().forward(batch, reduction)
        action = batch["action"]
        with torch.no_grad():
            teacher = Denoiser(self.teacher.to(action.device).bind(batch), self.config.noise)
            target = self.denoiser(self.averaged.bind(batch))
        network = self.network if self.training else self.averaged
        loss = distillation_loss(
            self.denoiser(network.bind(batch)),
            target,
            teacher,
            action,
            mask=~batch["action_is_pad"] if "action_is_pad" in batch else None,
            samples=self.config.samples_per_item,
        )
        return (loss.mean() if reduction == "mean" else loss), {}

    def loss(self, network: BoundVelocity, action: Tensor, mask: Tensor | None) -> Tensor:
        """The teacher's."""
        config, denoiser = self.config, self.denoiser(network)
        return edm_loss(
            denoiser, action, p_mean=config.p_mean, p_std=config.p_std, mask=mask, samples=config.samples_per_item
        )

    def sample(self, network: BoundVelocity, noise: Tensor) -> Tensor:
        """Normalised chunks (B, T, A) from noise of that shape: a teacher follows its ODE, a student leaps."""
        denoiser, config = self.denoiser(network), self.config
        grid = config.noise.grid(like=noise, levels=config.num_inference_steps + 1)
        x = grid[0] * noise
        return solve(denoiser, x, grid) if config.stage == "teacher" else denoiser(x, grid[:1].expand(len(x)))

    def denoiser(self, network: BoundVelocity) -> Denoiser:
        """What a network of this policy is part of: a teacher's denoiser or a student's consistency function."""
        config = self.config
        return Denoiser(network, config.noise, identity=config.sigma_min if config.stage == "student" else 0.0)

    @torch.no_grad()
    def bind(self, observation: Mapping[str, Tensor]) -> "BoundCsaAssist":
        """See `lerobot_gloves.adapter.Adapter`.

        Raises:
            ValueError: If this is a teacher.
        """
        if self.config.stage == "teacher":
            path = self.config.pretrained_path or "<its checkpoint>"
            raise ValueError(
                f"{path} is a csa_assist teacher, which corrects nothing: distil it, lerobot-train "
                f"--policy.type=csa_assist --policy.stage=student --policy.teacher={path}, and take the student"
            )
        if self.training:  # to ask every module takes a millisecond
            self.eval()
        return BoundCsaAssist(self.velocity(observation), self.denoiser)


class BoundCsaAssist:
    """The consistency function of B contexts (see `lerobot_gloves.adapter.BoundAdapter`)."""

    def __init__(self, network: BoundVelocity, denoiser: Callable[[BoundVelocity], Denoiser]):
        self.network, self._denoiser = network, denoiser

    @property
    def evaluations(self) -> int:
        return self.network.evaluations

    def select(self, rows: Tensor) -> "BoundCsaAssist":
        return BoundCsaAssist(self.network.select(rows), self._denoiser)

    def edit(self, proposal: Tensor, editor: CSA, **given: Any) -> Tensor:
        return editor(proposal, Reference(self._denoiser(self.network), **given))


def teacher_of(student: CsaAssistConfig) -> CsaAssistConfig:
    """The configuration of the checkpoint that `student.teacher` names.

    Raises:
        ValueError: If there is no such checkpoint, or none of a teacher.
    """
    path = str(student.teacher)
    option = f"--policy.teacher={path}"
    try:
        config = PreTrainedConfig.from_pretrained(path)
    except (FileNotFoundError, HFValidationError) as error:
        raise ValueError(f"{option} is no checkpoint's folder, nor one on the Hub in reach") from error
    if not isinstance(config, CsaAssistConfig) or config.stage != "teacher":
        kind = "csa_assist student" if isinstance(config, CsaAssistConfig) else f"policy of type {config.type!r}"
        raise ValueError(
            f"{option} is a {kind}, but a student is distilled from a csa_assist teacher: train one by "
            "--policy.type=csa_assist --policy.stage=teacher"
        )
    return config


def load_teacher(student: CsaAssistConfig) -> VelocityNetwork:
    """The averaged network of the checkpoint that `student.teacher` names, frozen.

    Raises:
        ValueError: If there is no such checkpoint, or none that this student could start from.
    """
    config, path = teacher_of(student), str(student.teacher)
    for name in SHARED:
        theirs, ours = getattr(config, name), getattr(student, name)
        if theirs != ours:
            raise ValueError(
                f"--policy.teacher={path} has {name}={theirs}, but the student has {ours}: they must agree, since the "
                "student starts from the teacher's weights"
            )
    config.pretrained_path, config.device = path, student.device
    # Weights are drawn before they are loaded, but a resumed run's draws shall go on where they were.
    with torch.random.fork_rng(devices=[]):
        policy = cast(CsaAssistPolicy, load_weights(config, merged=True))
    return policy.averaged.requires_grad_(False)
