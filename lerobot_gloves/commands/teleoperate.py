"""`gloves teleoperate`, `gloves record --teleop...`: LeRobot's own commands, and what a person commands corrected."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from lerobot.configs import parser
from lerobot.processor import (
    ProcessorStepRegistry,
    RobotProcessorPipeline,
    make_default_robot_action_processor,
)
from lerobot.processor.converters import (
    observation_to_transition,
    robot_action_observation_to_transition,
    transition_to_observation,
    transition_to_robot_action,
)
from lerobot.robots import Robot, RobotConfig
from lerobot.scripts import lerobot_record, lerobot_teleoperate
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import hw_to_dataset_features

from lerobot_gloves.commands.assisting import AssistanceConfig
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.drive.held_key import HeldKey

COMMANDED, EDITED = "commanded", "edited"
"""Features of a recorded dataset beside the action that was executed. LeRobot hands no policy these."""


@dataclass
class LimitsConfig:
    """How far assistance may go."""

    # How far an edit may move an entry of the action, as a share of its range in the demonstrations that the adapter
    # was trained on; null for any distance.
    edit: float | None = 0.1
    # The dead man's key: assistance acts while it is held, and commands are executed as they are while it is not. A
    # letter, a digit, or a key such as space or shift; null for none, which assists all the time.
    key: str | None = "space"


@dataclass
class TeleoperateConfig(lerobot_teleoperate.TeleoperateConfig):
    """Teleoperate a robot as by lerobot-teleoperate, whose options these are, and have the commands corrected.

    gloves teleoperate --robot.type=so101_follower ... --teleop.type=so101_leader ... --policy.adapter=COPILOT --fps=30
    """

    # What corrects the person.
    policy: AssistanceConfig = field(default_factory=AssistanceConfig)
    # How far that may go.
    limits: LimitsConfig = field(default_factory=LimitsConfig)


@dataclass
class RecordConfig(lerobot_record.RecordConfig):
    """Record a person's teleoperation as by lerobot-record, whose options these are, and have the commands corrected.

    gloves record --robot.type=so101_follower ... --teleop.type=so101_leader ... --policy.adapter=COPILOT
    --dataset.repo_id=USER/NAME --dataset.single_task="Put the cube into the box"

    The dataset's action is what was executed; what was commanded is a feature of its own.
    """

    # What corrects the person.
    policy: AssistanceConfig = field(default_factory=AssistanceConfig)
    # How far that may go.
    limits: LimitsConfig = field(default_factory=LimitsConfig)


@parser.wrap()
def teleoperate(config: TeleoperateConfig) -> None:
    """Teleoperate until interrupted."""

    def processors() -> tuple[Any, Any, Any]:
        return _corrects(step), make_default_robot_action_processor(), _shows(step)

    with _step(config, config.fps) as step, _instead(lerobot_teleoperate, make_default_processors=processors):
        lerobot_teleoperate.teleoperate.__wrapped__(config)


@parser.wrap()
def record(config: RecordConfig) -> Any:
    """Record; the dataset."""
    features, frame, loop = (
        getattr(lerobot_record, name)
        for name in ("aggregate_pipeline_dataset_features", "build_dataset_frame", "record_loop")
    )

    def with_ours(*, pipeline: Any, **options: Any) -> dict[str, Any]:
        found = features(pipeline=pipeline, **options)
        if ACTION in found:
            found[COMMANDED] = dict(found[ACTION])
            found[EDITED] = {"dtype": "float32", "shape": (1,), "names": [EDITED]}
        return found

    def framed(known: dict[str, Any], values: dict[str, Any], prefix: str) -> dict[str, np.ndarray]:
        found = frame(known, values, prefix=prefix)
        if prefix == ACTION:
            found |= {COMMANDED: step.commanded.copy(), EDITED: np.array([step.edited], dtype=np.float32)}
        return found

    def looped(*arguments: Any, **options: Any) -> None:
        step.reset()  # LeRobot's loop is an episode, or the time in which the scene is set up again
        loop(*arguments, **options)

    ours: dict[str, Callable] = {
        "aggregate_pipeline_dataset_features": with_ours,
        "build_dataset_frame": framed,
        "record_loop": looped,
    }
    with _step(config, config.dataset.fps, config.dataset.single_task) as step, _instead(lerobot_record, **ours):
        shows = _shows(step) if config.display_data else None
        return lerobot_record.record.__wrapped__(config, _corrects(step), None, shows)


@contextmanager
def _step(config: TeleoperateConfig | RecordConfig, fps: int, task: str = "") -> Iterator[Any]:
    """The step that corrects, while its dead man's key is listened to.

    Raises:
        ValueError: If there is no adapter, or it does not fit the robot.
    """
    if config.policy.adapter is None:
        raise ValueError("nothing would correct: name an adapter by --policy.adapter, or use LeRobot's own command")
    options = asdict(config.policy)
    how = {"limit": config.limits.edit, "fps": fps, "task": task, "device": options.pop("device")}
    with ExitStack() as stack:
        if config.limits.key is not None:
            how["wanted"] = stack.enter_context(HeldKey(config.limits.key))
        yield ProcessorStepRegistry.get("gloves_correction")(_features(config.robot), options, **how)


def _features(config: RobotConfig) -> dict[str, dict[str, Any]]:
    """What a robot shows and takes, as a dataset's features."""
    robot: Robot = lerobot_record.make_robot_from_config(config)
    return hw_to_dataset_features(robot.action_features, ACTION) | hw_to_dataset_features(
        robot.observation_features, OBS_STR
    )


def _corrects(step: Any) -> RobotProcessorPipeline:
    return RobotProcessorPipeline(
        steps=[step], to_transition=robot_action_observation_to_transition, to_output=transition_to_robot_action
    )


def _shows(step: Any) -> RobotProcessorPipeline:
    return RobotProcessorPipeline(
        steps=[ProcessorStepRegistry.get("gloves_shown")(step)],
        to_transition=observation_to_transition,
        to_output=transition_to_observation,
    )


@contextmanager
def _instead(module: ModuleType, **functions: Callable) -> Iterator[None]:
    """Have a command of LeRobot's call other functions, for which it has no option."""
    before = {name: getattr(module, name) for name in functions}
    vars(module).update(functions)
    try:
        yield
    finally:
        vars(module).update(before)


def main() -> None:
    """Entry point of both."""
    start()
    command = sys.argv[0]
    with one_line_errors(command):
        record() if command.endswith("record") else teleoperate()
