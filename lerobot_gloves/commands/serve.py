"""`gloves serve`: LeRobot's asynchronous policy server, which also knows plugins and wrapped policies."""

from dataclasses import asdict, dataclass

from lerobot.configs import PreTrainedConfig, parser
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.utils.utils import init_logging

from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.system.errors import one_line


@dataclass
class ServeConfig:
    """Start LeRobot's policy server with every policy of LeRobot and of the plugins that are installed here.

    gloves serve --host=0.0.0.0 --port=8080 --fps=30

    A robot's computer then runs LeRobot's client, which names a wrapped policy by the folder that it was saved to:

    python -m lerobot.async_inference.robot_client --policy_type=gloves --pretrained_name_or_path=WRAPPER
    --server_address=HOST:8080 --actions_per_chunk=10 --robot.type=...
    """

    # Address to listen at; 0.0.0.0 for every one that this computer has. Whoever reaches it can run programs here.
    host: str = "localhost"
    # Port to listen at.
    port: int = 8080
    # Actions a second that the robot executes.
    fps: int = 30
    # Seconds that an answer takes at least.
    inference_latency: float = 1 / 30
    # Seconds to wait for an observation before a client is answered that there is none.
    obs_queue_timeout: float = 2

    def __post_init__(self) -> None:
        if self.fps < 1:
            raise ValueError(f"fps is {self.fps}, but must be at least 1")
        if not 1 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}, but must lie between 1 and 65535")
        for name in ("inference_latency", "obs_queue_timeout"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}, but must not be negative")


@parser.wrap()
def serve(config: ServeConfig) -> None:
    """Serve until interrupted.

    Raises:
        ImportError: If gRPC is not installed.
        ConnectionError: If it cannot listen at that address.
    """
    try:
        # LeRobot sets logging up when these are imported, and begins a log in ./logs.
        from lerobot.async_inference import policy_server
        from lerobot.async_inference.configs import PolicyServerConfig
    except ImportError as error:
        reason = one_line(error)
        raise ImportError(f"{reason}: the server needs pip install 'lerobot_policy_gloves[serve]'") from error
    # The list is LeRobot 0.6's, to which plugins are unknown; a later server takes whatever is registered.
    listed = getattr(policy_server, "SUPPORTED_POLICIES", None)
    if listed is not None:
        listed.extend(sorted(plugin_policies() - set(listed)))
    # Who serves knows how often a robot acts, and clients bring wrappers later.
    PreTrainedConfig.get_choice_class("gloves").control_period = 1000 / config.fps
    try:
        policy_server.serve(PolicyServerConfig(**asdict(config)))
    except RuntimeError as error:
        raise ConnectionError(f"cannot listen at {config.host}:{config.port}: {one_line(error)}") from error


def plugin_policies() -> set[str]:
    """Types of policies that are registered here and are not LeRobot's own."""
    known = PreTrainedConfig.get_known_choices().items()
    return {name for name, config in known if config.__module__.partition(".")[0] != "lerobot"}


def main() -> None:
    """Entry point."""
    init_logging()
    register_third_party_plugins()
    with one_line_errors("gloves serve"):
        serve()
