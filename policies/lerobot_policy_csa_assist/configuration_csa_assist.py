"""Settings of the baseline `csa_assist`.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from dataclasses import dataclass, field

from lerobot.configs import PreTrainedConfig

from gloves_flow.configuration_flow import FlowConfig

from .edm import NoiseLevels

STAGES = ("teacher", "student")

SHARED = (
    "input_features",
    "output_features",
    "normalization_mapping",
    "chunk_size",
    "context_dim",
    "width",
    "depth",
    "heads",
    "mlp_ratio",
    "time_dim",
    "backbone_norm",
    "sigma_min",
    "sigma_max",
    "sigma_data",
)
"""Settings that a student and its teacher have in common: they decide what the teacher's weights mean."""


@PreTrainedConfig.register_subclass("csa_assist")
@dataclass
class CsaAssistConfig(FlowConfig):
    """Consistency shared autonomy: first a diffusion teacher, then the student that is distilled from it.

    FlashBack scales actions to [-1, 1] and sets sigma_data, the actions' standard deviation, to 0.5. Here actions are
    normalised to unit variance as for the flows, so sigma_data is 1: that they have the variance they are said to have
    is all that Karras' scalings ask for. A level's sigma is measured in these units, and the sweep over levels finds
    the one that suits them.

    FlashBack's second condition, the direction of the state that a model of the robot foresees for the user's single
    action, has no counterpart for chunks and images, and is left out: intent comes from the proposal alone. What is
    left is the state, which is always given, hence no context dropout.
    """

    # What is trained: teacher, or student, which is distilled from --policy.teacher and is what corrects.
    stage: str = "teacher"
    # Folder or Hub id of the teacher that a student starts from and copies; only its training needs it.
    teacher: str | None = None

    # Smallest noise level, taken for no noise; in normalised action units, as all levels.
    sigma_min: float = 0.002
    # Largest noise level.
    sigma_max: float = 80.0
    # Exponent of Karras' grid of noise levels.
    rho: float = 7.0
    # Number of noise levels in the grid, which a student is distilled on and CSA's level counts.
    levels: int = 80
    # Standard deviation of the normalised actions.
    sigma_data: float = 1.0
    # Mean of log sigma in the teacher's training: Karras' -1.2, which goes with a sigma_data of 0.5, plus ln 2
    # (rounded), since sigma_data is twice that here.
    p_mean: float = -0.5
    # Standard deviation of log sigma in the teacher's training.
    p_std: float = 1.2

    # Heun steps, of two evaluations each, that sample a chunk from a teacher; 79 are all of the default grid. A
    # student makes one evaluation.
    num_inference_steps: int = 79
    # Probability of training without the context; a student never does.
    context_dropout: float = 0.0
    # Observations that neither stage is conditioned on.
    exclude_features: list[str] = field(default_factory=lambda: ["observation.goal"])

    def validate_features(self) -> None:
        """Check the settings too. LeRobot's commands would not print what goes wrong while they build them.

        Raises:
            ValueError: If a setting makes no sense, or a needed feature is missing (see `FlowConfig`).
        """
        if self.stage not in STAGES:
            raise ValueError(f"csa_assist has no stage {self.stage!r}: choose from {', '.join(STAGES)}")
        if not 0 < self.sigma_min < self.sigma_max:
            raise ValueError(
                f"csa_assist: sigma_min is {self.sigma_min} and sigma_max is {self.sigma_max}, but 0 < sigma_min < "
                "sigma_max must hold"
            )
        for name, least in (("levels", 2), ("num_inference_steps", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"csa_assist: {name} is {getattr(self, name)}, but must be at least {least}")
        for name in ("rho", "sigma_data", "p_std"):
            if getattr(self, name) <= 0:
                raise ValueError(f"csa_assist: {name} is {getattr(self, name)}, but must be above 0")
        if self.stage == "student":
            self._check_student()
        super().validate_features()

    def _check_student(self) -> None:
        if not self.teacher:
            raise ValueError("csa_assist: a student is distilled from a teacher: name its checkpoint, --policy.teacher")
        if self.context_dropout or self.guidance != 1.0:
            raise ValueError(
                f"csa_assist: a student copies the teacher in context only, so context_dropout must be 0 and guidance "
                f"1, not {self.context_dropout} and {self.guidance}"
            )
        self.pretrained_backbone_weights = self.teacher  # which all weights of it start from

    @property
    def noise(self) -> NoiseLevels:
        """The noise levels that these settings describe."""
        return NoiseLevels(self.sigma_min, self.sigma_max, self.rho, self.levels, self.sigma_data)
