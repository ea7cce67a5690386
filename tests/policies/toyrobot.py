"""A robot of two joints that moves as it is told, and stops its operator's program when it has been told enough."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.robots import Robot, RobotConfig

JOINTS = ("shoulder.pos", "elbow.pos")
INPUTS = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (2,))}


@RobotConfig.register_subclass("gloves_toy")
@dataclass(kw_only=True)
class ToyRobotConfig(RobotConfig):
    """Commands until it stops the program."""

    steps: int = 10


class ToyRobot(Robot):
    """Adds half of each command to its joints."""

    config_class, name = ToyRobotConfig, "gloves_toy"
    sent: ClassVar[list[list[float]]] = []
    cameras: ClassVar[dict] = {}
    observation_features = action_features = dict.fromkeys(JOINTS, float)
    is_connected = is_calibrated = False

    def __init__(self, config: ToyRobotConfig):
        super().__init__(config)
        self.steps = config.steps
        self.joints = torch.tensor([0.3, -0.2], dtype=torch.float64)
        ToyRobot.sent = []

    def connect(self, calibrate: bool = True) -> None:
        self.is_connected = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def get_observation(self) -> dict[str, float]:
        if len(ToyRobot.sent) == self.steps:
            raise KeyboardInterrupt
        return dict(zip(JOINTS, self.joints.tolist(), strict=True))

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        command = [action[joint] for joint in JOINTS]
        ToyRobot.sent.append(command)
        self.joints += 0.5 * torch.tensor(command)
        return action

    def disconnect(self) -> None:
        self.is_connected = False
