"""Settings of the wrapper.

The comments above the fields are what LeRobot's `--help` shows; it cannot read attributes in a docstring.
"""

from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, cast

import draccus
from lerobot.configs import PolicyFeature, PreTrainedConfig

from lerobot_gloves.checkpoints.configuration import checkpoint_config
from lerobot_gloves.perturbations import CHOICES, Perturbation

from ..untrained import Untrained

PASSTHROUGH = Path(str(files(__package__))) / "passthrough"
"""Saved processor pipelines that change nothing: what LeRobot loads around the wrapper."""


@dataclass
class PerturbationConfig(draccus.ChoiceRegistry):
    """Chooses a perturbation by `--policy.perturbation.type=NAME`; its fields are the perturbation's own.

    Several are `--policy.perturbation.type=compound --policy.perturbation.parts=noised:sigma=0.005+laggy:p=0.2`.
    """


for _name, _class in CHOICES.items():
    # The library's classes know nothing of draccus, which writes a choice's type only if it is a subclass, and looks
    # for the comments that explain its fields where it says that its source is.
    _source = {key: value for key, value in vars(_class).items() if key in ("__module__", "__firstlineno__")}
    PerturbationConfig.register_subclass(_name)(type(_class.__name__, (_class, PerturbationConfig), _source))


def library_perturbation(chosen: PerturbationConfig) -> Perturbation:
    """The library's own of the perturbation that a configuration chooses."""
    return CHOICES[chosen.get_choice_name(type(chosen))](**asdict(chosen))


@PreTrainedConfig.register_subclass("gloves")
@dataclass
class GlovesConfig(Untrained, PreTrainedConfig):
    """An agent, and the adapter that corrects it.

    The same three ways as for any policy: `--policy.path=AGENT --policy.wrap=gloves`, `--policy.type=gloves
    --policy.agent=AGENT`, and `--policy.path=` a folder that this wrapper was saved to.
    """

    # Folder or Hub id of the policy to be corrected.
    agent: str | None = None
    # The agent's Hub revision.
    agent_revision: str | None = None
    # Options for the agent's configuration, such as '["--n_action_steps=5"]'. With --policy.wrap, options that the
    # wrapper does not know reach the agent by themselves.
    agent_overrides: list[str] = field(default_factory=list)
    # Folder or Hub id of the checkpoint that scores and edits; null leaves the agent as it is.
    adapter: str | None = None
    # The adapter's Hub revision.
    adapter_revision: str | None = None
    # Options for the adapter's configuration, such as '["--agent_source=noised"]'.
    adapter_overrides: list[str] = field(default_factory=list)
    # Observation keys of the environment to those that the adapter was trained on.
    adapter_rename_map: dict[str, str] = field(default_factory=dict)
    # The editor and its options, NAME[:KEY=VALUE,...], such as feeg:start=0.4; none edits nothing. By default what
    # gloves tune recommends, with its gate, score and alpha, else the adapter's own: feeg for an expert flow, ifae for
    # an align flow.
    method: str | None = None
    # Whether chunks that look like the expert's pass unchanged; needs a calibrated adapter. By default as gloves tune
    # recommends, if no method is named, else false.
    gate: bool | None = None
    # The gate's significance level: the share of expert chunks that it would turn away. By default as gloves tune
    # recommends, if no method is named, else 0.05.
    alpha: float | None = None
    # What alpha is a share of: chunks, or episodes, of which the others then pass from beginning to end.
    alpha_of: str = "chunks"
    # The nonconformity score and its options, such as reverse:steps=5. By default the adapter's first, if it has any,
    # and with --policy.gate=true a copilot's correction. Several are joined by +, as in reverse:steps=5+correction:
    # each must admit a chunk, at its part of alpha.
    score: str | None = None
    # What is done to the agent's chunks to make it imperfect; null for nothing.
    perturbation: PerturbationConfig | None = None
    # Seed of the perturbation's and the editor's draws; with the episode's number it fixes them.
    seed: int = 0
    # File that receives one JSON line a chunk of what the wrapper did.
    log: Path | None = None
    # Whether these lines also hold the proposed and the executed actions, raw.
    log_actions: bool = False
    # Whether to show the first environment's steps in rerun, LeRobot's viewer: observation, proposed and executed
    # action, score and p-value.
    display_data: bool = False
    # Address of a viewer that runs already; by default one is opened here.
    display_ip: str | None = None
    # Port of that viewer.
    display_port: int | None = None
    # Milliseconds between two actions of the program that runs the wrapper; no option, see `note_control_period`.
    control_period: ClassVar[float | None] = None
    instead: ClassVar[str] = (
        "gloves wraps a policy for evaluation; train an adapter, such as --policy.type=gloves_expert_flow"
    )
    push_to_hub: bool = False  # A wrapper is not trained, so there is nothing to push by itself.

    def __post_init__(self) -> None:
        for name in ("agent", "adapter"):
            if getattr(self, name) == "":
                raise ValueError(f"gloves: --policy.{name} is empty, but must be a folder or Hub id")
        if self.alpha_of not in ("chunks", "episodes"):
            raise ValueError(f"gloves: unknown alpha_of {self.alpha_of!r}: choose from chunks, episodes")
        if self.seed < 0:
            raise ValueError(f"gloves: seed is {self.seed}, but must not be negative")
        if self.adapter is None and (self.gate or self.method not in (None, "none")):
            raise ValueError("gloves: --policy.method and --policy.gate need --policy.adapter, a trained checkpoint")
        given = cast("PerturbationConfig | Perturbation | None", self.perturbation)
        if isinstance(given, Perturbation) and not isinstance(given, PerturbationConfig):
            # The library's own, from Python: draccus would save it without its name.
            name = next(name for name, choice in CHOICES.items() if choice is type(given))
            self.perturbation = PerturbationConfig.get_choice_class(name)(**asdict(given))
        if self.agent:
            self._adopt(self.agent)
        super().__post_init__()

    def _adopt(self, agent: str) -> None:
        """Read the agent's configuration and take over what LeRobot asks a policy's configuration for."""
        # A plain attribute: draccus expands a field of this type into every registered policy, without end.
        self.agent_config = checkpoint_config("policy.agent", agent, self.agent_overrides, self.agent_revision)
        if isinstance(self.agent_config, GlovesConfig):
            raise ValueError(f"{agent} is a gloves wrapper already: leave out --policy.wrap, or name its agent")
        self.agent_config.pretrained_path = agent
        self.agent_config.pretrained_revision = self.agent_revision
        self.input_features: dict[str, PolicyFeature] = dict(self.agent_config.input_features or {})
        self.output_features: dict[str, PolicyFeature] = dict(self.agent_config.output_features or {})
        self.device: str = self.device or self.agent_config.device
        self.use_amp: bool = self.use_amp or self.agent_config.use_amp
        self.n_obs_steps = self.agent_config.n_obs_steps
        if self.pretrained_path is None:
            self.pretrained_path: Path | None = PASSTHROUGH

    def __getattr__(self, name: str) -> Any:
        # LeRobot probes a policy's configuration for fields that only some have (rtc_config, n_action_steps, ...).
        agent_config = self.__dict__.get("agent_config")
        if name.startswith("_") or agent_config is None:
            raise AttributeError(name)
        return getattr(agent_config, name)

    def __setattr__(self, name: str, value: Any) -> None:
        # With --policy.path=AGENT --policy.wrap=gloves, LeRobot assigns the agent's path to what it takes for the
        # agent's configuration. It has been noted as `agent`; the wrapper's own processors are the pass-through ones.
        agent = self.__dict__.get("agent")
        if name == "pretrained_path" and value is not None and agent is not None and Path(value) == Path(agent):
            value = PASSTHROUGH
        super().__setattr__(name, value)


def note_control_period(command: Any) -> None:
    """Tell a wrapper how often the command that it is parsed for acts, if the command says so: `--fps`, `--env.fps`."""
    policy = getattr(command, "policy", None)
    rate = getattr(command, "fps", None) or getattr(getattr(command, "env", None), "fps", None)
    if isinstance(policy, GlovesConfig) and rate:
        policy.control_period = 1000 / rate  # type: ignore[misc]
