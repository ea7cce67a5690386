"""A leader of the toy robot's two joints, which is moved as a script says."""

from dataclasses import dataclass
from itertools import cycle
from typing import Any, ClassVar

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from tests.policies.toyrobot import JOINTS

SCRIPT = [[0.01, -0.02], [0.01, -0.02], [0.05, 0.025], [-0.03, 1 / 30], [0.0, 0.0]]
"""Commands, again and again; a thirtieth is no number of 32 bits."""


@TeleoperatorConfig.register_subclass("gloves_toy_leader")
@dataclass(kw_only=True)
class ToyLeaderConfig(TeleoperatorConfig):
    """What its joints are called."""

    joints: list[str]


class ToyLeader(Teleoperator):
    """Commands what the script says next."""

    config_class, name = ToyLeaderConfig, "gloves_toy_leader"
    script: ClassVar[list[list[float]]] = SCRIPT
    commanded: ClassVar[list[list[float]]] = []
    feedback_features: ClassVar[dict] = {}
    is_connected = is_calibrated = False

    def __init__(self, config: ToyLeaderConfig):
        super().__init__(config)
        self.joints = config.joints
        self._next = cycle(ToyLeader.script)
        ToyLeader.commanded = []

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(self.joints, float)

    def connect(self, calibrate: bool = True) -> None:
        self.is_connected = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def get_action(self) -> dict[str, Any]:
        ToyLeader.commanded.append(next(self._next))
        return dict(zip(self.action_features, ToyLeader.commanded[-1], strict=False))

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...

    def disconnect(self) -> None:
        self.is_connected = False


TOY = ("--robot.type=gloves_toy", "--teleop.type=gloves_toy_leader", f"--teleop.joints=[{', '.join(JOINTS)}]")
